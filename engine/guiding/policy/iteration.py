# SPDX-License-Identifier: GPL-3.0-or-later
"""What one iteration of a render was: all that learns or asks reads it, nobody writes it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from engine.guiding.policy.costs import IterationCosts
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.policy.way import ImageState
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import VertexRecords, join_records
from engine.state.film import FilmTile
from engine.state.unit import PLAIN


@dataclass(frozen=True)
class Traced:
    """What a render hands over between two iterations.

    units : UnitRecords of each tile, in an order that does not depend on threads
    recorded_share : float, of the guided paths that were recorded
    sums : FilmTile, the image so far
    size : (int, int), rows and columns of the image
    costs : IterationCosts, without the bridge's (`engine.render.bridge`)
    next_range : (int, int), first sample and samples a pixel of the next iteration
    is_whole : bool, whether the next iteration's samples lie in all of u, not in a stratum
    """

    units: Sequence[UnitRecords]
    recorded_share: float
    sums: FilmTile
    size: tuple[int, int]
    costs: IterationCosts
    next_range: tuple[int, int]
    is_whole: bool = True


@dataclass(frozen=True)
class Iteration:
    """What one iteration was, and what is known of the next.

    traced : Traced, with what was kept of earlier iterations that nothing was learned from
    index : int, of this iteration, from 1
    arms : sequence of ArmSamples, by what it was rendered
    was_guided : bool, whether its paths were, but for those of the arm PLAIN
    pixel_share : float, of the pixels that had guided samples
    samples : float, guided ones a pixel that there are records of
    image : ImageState
    is_early : bool, nothing is learned from it yet: its records wait for those of the next
    samples_left : float, a pixel, as far as it is known
    is_next_last : bool, nobody will go by what the next iteration finds
    learning_seconds : float, that learning what guides took the last time of the tracing threads' time [s]
    """

    traced: Traced
    index: int
    arms: Sequence[ArmSamples]
    was_guided: bool
    pixel_share: float
    samples: float
    image: ImageState
    is_early: bool
    samples_left: float
    is_next_last: bool
    learning_seconds: float

    @property
    def sums(self) -> FilmTile:
        """The image so far."""
        return self.traced.sums

    @property
    def costs(self) -> IterationCosts:
        """What its threads measured."""
        return self.traced.costs

    @property
    def next_range(self) -> tuple[int, int]:
        """First sample and samples a pixel of the next iteration."""
        return self.traced.next_range

    @property
    def next_sample(self) -> int:
        """First sample of the next iteration."""
        return self.traced.next_range[0]

    @cached_property
    def _joined(self) -> tuple[VertexRecords, int]:
        return join_records([unit.vertices for unit in self.traced.units])

    @property
    def records(self) -> VertexRecords:
        """What its paths recorded at their vertices, tile by tile."""
        return self._joined[0]

    @property
    def row_count(self) -> int:
        """How many records there are."""
        return self._joined[1]

    @property
    def guided_share(self) -> float:
        """Share of its samples that were guided, where any were."""
        return guided_share(self.arms)

    @property
    def sample_count(self) -> int:
        """Samples a pixel, guided and not."""
        return sum(count for _, count, _ in self.arms)

    @property
    def path_count(self) -> float:
        """Recorded paths."""
        share = self.guided_share * self.pixel_share
        return self.traced.recorded_share * share * self.costs.path_count

    @property
    def seconds(self) -> float:
        """What tracing its guided part took, of all threads together [s]."""
        return self.guided_share * sum(self.costs.stage_seconds.values())


def guided_share(arms: Sequence[ArmSamples]) -> float:
    """Share of the samples that are not of the arm PLAIN."""
    counts = [(count, arm != PLAIN) for _, count, arm in arms]
    return sum(count for count, is_guided in counts if is_guided) / sum(count for count, _ in counts)
