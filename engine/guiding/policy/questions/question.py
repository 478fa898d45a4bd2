# SPDX-License-Identifier: GPL-3.0-or-later
"""What a question is: something that a render finds out about itself while it goes."""

from __future__ import annotations

from collections.abc import Sequence

from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.policy.way import Way
from engine.state.film import FilmTile
from engine.state.unit import Unit


class Question:
    """Asks whether one way of rendering pays more than another; this one asks nothing.

    It renders a part of an iteration's samples another way and compares, or it goes by what records promise. A new
    question is a class like this and a line of `engine.guiding.policy.sets`, whose order is their precedence.

    Attributes
    ----------
    other_arms : sequence of ArmSamples
        Arms of units that have no pixels of a trial, in the iteration in work; empty: all units have the same arms.
    """

    other_arms: Sequence[ArmSamples] = ()

    @property
    def is_over(self) -> bool:
        """Whether it is never to be asked again."""
        return False

    @property
    def is_settled(self) -> bool:
        """Whether questions after it need not wait for its answer."""
        return True

    @property
    def is_comparing(self) -> bool:
        """Whether it is in the middle of several comparisons, which questions before it do not break off."""
        return False

    @property
    def pixel_share(self) -> float:
        """Share of the pixels that it lets the iteration in work guide."""
        return 1.0

    def begin(self) -> None:
        """Tracing begins."""

    def narrow(self, pixel_count: int, expected_samples: float) -> None:
        """Take how many pixels the next iteration has, and how many samples all are still to get on average."""

    def observe(self, unit: Unit, film: FilmTile, cost: float, *, is_aside: bool) -> None:
        """Take a finished unit's sums and its cost, in any unit; no two threads at once.

        `is_aside`: none of its pixels is guided in the iteration in work.
        """

    def conclude(self, iteration: Iteration) -> None:
        """After an iteration, before anything is learned from it: draw the conclusion, if it compared."""

    def plan(self, iteration: Iteration, *, is_free: bool) -> Sequence[ArmSamples]:
        """Once all has been learned from an iteration: arms of the next one, if it is to compare.

        Parameters
        ----------
        iteration : Iteration
        is_free : bool
            Whether no other question needs the next iteration.

        Returns
        -------
        sequence of ArmSamples
            Empty: it compares nothing.
        """
        return ()

    def way(self, way: Way) -> Way:
        """How paths go by what it has found out, given how they go by the questions before it."""
        return way

    def challenge(self, way: Way) -> Way:
        """How those of the arm CHALLENGER go, where its own arms have that arm, given how all others go."""
        return way

    def rehearse(self, channel_count: int) -> None:
        """Load (or compile) the kernels of comparing."""
