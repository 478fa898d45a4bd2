# SPDX-License-Identifier: GPL-3.0-or-later
"""Records for whoever asked for them."""

from __future__ import annotations

from engine.guiding.models.record_sink import RecordSink
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.standing import Standing


class Handed(Learnable):
    """Hands the records of guided renders to a sink.

    Parameters
    ----------
    sink : RecordSink
    standing : Standing
    regions : LearnedRegions
    """

    serves_guiding = False

    def __init__(self, sink: RecordSink, standing: Standing, regions: LearnedRegions) -> None:
        self._sink, self._standing, self._regions = sink, standing, regions

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    def learn(self, iteration: Iteration) -> None:
        if self._regions.models is not None:
            self._sink.take(iteration.records, iteration.row_count)
