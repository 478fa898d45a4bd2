# SPDX-License-Identifier: GPL-3.0-or-later
"""What a learnable is: something that is learned from the records of each iteration, and that paths then go by."""

from __future__ import annotations

from dataclasses import dataclass

from engine.guiding.fields.state import State
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.way import ImageState, Way
from engine.guiding.records.vertices import VertexRecords


@dataclass(frozen=True)
class Rehearsal:
    """Records of nothing in particular, to load the kernels of learning with.

    records : VertexRecords, all of them known
    row_count : int
    """

    records: VertexRecords
    row_count: int


class Learnable:
    """Learns something from the records of each iteration; this one learns nothing.

    A new learnable is a class like this and a line of `engine.guiding.policy.sets`.

    Attributes
    ----------
    serves_guiding : bool
        Whether what it learns is of use to guided paths alone, so that guiding has to pay for it.
    """

    serves_guiding: bool = True

    @property
    def is_over(self) -> bool:
        """Whether it learns nothing any more; what it has learned may still be gone by."""
        return False

    def learn(self, iteration: Iteration) -> None:
        """Learn from an iteration."""

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        """Guidance with what it has learned, for paths that go this way."""
        return guidance

    def state(self) -> State:
        """All that it knows that others can start from, as arrays."""
        return {}

    def rehearse(self, rehearsal: Rehearsal) -> None:
        """Load (or compile) the kernels of learning by learning from nothing in particular."""

    def stop(self) -> None:
        """Guiding has been given up: end all that only guided paths need."""

    def close(self) -> None:
        """The render is over."""
        self.stop()
