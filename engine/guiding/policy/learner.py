# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render sees of all that learns in it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Traced
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.saved.learned import LearnedField
from engine.scene.description import Notice
from engine.state.film import FilmTile
from engine.state.unit import Unit, UnitCosts


class Learner(Protocol):
    """Learns between the iterations of a render, and says by it how the next one goes.

    The lengths of iterations are functions of their index alone. What is learned concerns distributions and candidate
    counts, and which method goes on: every sample has the expected value of the image, whatever the earlier ones were.
    Its weight may depend on these, and with a time limit the number of samples does. The bias that this leaves in the
    mean is at most a few hundredths of its own standard error (docs/decisions/trial-and-choice.md).
    """

    notices: list[Notice]
    report: GuidingReport

    @property
    def arms(self) -> Sequence[ArmSamples]:
        """Parts of the iteration in work."""

    @property
    def other_arms(self) -> Sequence[ArmSamples]:
        """Arms of units that have no pixels of a trial; empty: all units have the same arms."""

    @property
    def is_over(self) -> bool:
        """Whether there is nothing more to learn, so that the render need not go in iterations."""

    @property
    def wants_last(self) -> bool:
        """Whether the last iteration's records are of use."""

    def weight(self, first_sample: int, arm: int) -> float:
        """Weight in the image of each sample of an arm in the iteration that begins with `first_sample`."""

    def begin(self) -> None:
        """Tracing begins."""

    def rehearse(self) -> None:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""

    def first(self) -> Guidance:
        """Guidance of the first iteration."""

    def narrow(self, pixel_count: int, expected_paths: float) -> None:
        """Take how many pixels the next iteration has, and how many paths they are expected to get in all."""

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """Take a finished unit's sums and costs; no two threads at once."""

    def learn(self, traced: Traced) -> Guidance:
        """Learn from an iteration, and say how to go on."""

    def take_last(self, units: Sequence[UnitRecords]) -> None:
        """Take the records of the last iteration, if they are wanted."""

    def learned(self, light_digest: str) -> LearnedField | None:
        """All that was learned so far of the scene of this digest, for other renders; None: nothing of use to them.

        Raises
        ------
        StateError
            If no render could start from it.
        """

    def close(self) -> None:
        """The render is over."""
