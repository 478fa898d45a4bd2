# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the iterations of a render: records -> learnables -> evidence -> questions -> guidance."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from engine.guiding.policy.agenda import Agenda
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import MethodCosts
from engine.guiding.policy.evidence import Evidence
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration, Traced
from engine.guiding.policy.iterations import is_narrow
from engine.guiding.policy.keeping import FieldKeeper
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.metered import LearningTime
from engine.guiding.policy.recording import Recording
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.trial import ArmSamples
from engine.guiding.policy.way import Way
from engine.guiding.records.unit_records import UnitRecords
from engine.guiding.records.vertices import allocate_vertex_records
from engine.guiding.saved.learned import LearnedField
from engine.state.film import FilmTile
from engine.state.unit import Unit, UnitCosts

#: Records that kernels of learning are rehearsed on.
_REHEARSED_RECORDS = 256


class Conductor:
    """The learner of a render (`engine.guiding.policy.learner`): what it learns and asks is made in `sets`.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
        Guiding's.
    learnables : sequence of Learnable
        In the order in which they learn; each may read what those before it have learned.
    agenda : Agenda
    evidence : Evidence
    costs : MethodCosts
    recording : Recording
    rest : callable (paths_per_sample) -> Recording, optional
        What records once guiding has been given up.
    keeper : FieldKeeper, optional
        None: nothing outlives the render.
    """

    def __init__(
        self, context: RenderContext, standing: Standing, learnables: Sequence[Learnable], agenda: Agenda,
        evidence: Evidence, costs: MethodCosts, recording: Recording, rest: Callable[[int], Recording] | None = None,
        keeper: FieldKeeper | None = None,
    ) -> None:
        self._context, self._standing, self.learnables, self.agenda = context, standing, list(learnables), agenda
        self._evidence, self._costs, self._keeper = evidence, costs, keeper
        self._recording, self._rest = recording, rest
        self.notices, self.report = context.notices, context.report
        self._learning_seconds = 0.0
        waiting_count = 0 if context.traces_while_learning else context.thread_count
        self._learning_time = LearningTime(context.executor, waiting_count)

    @property
    def arms(self) -> Sequence[ArmSamples]:
        return self.agenda.arms

    @property
    def other_arms(self) -> Sequence[ArmSamples]:
        return self.agenda.other_arms

    @property
    def is_over(self) -> bool:
        return self._recording.is_over

    @property
    def wants_last(self) -> bool:
        return self._keeper is not None and self._keeper.wants_last(self.agenda)

    def weight(self, first_sample: int, arm: int) -> float:
        is_part = bool(self.agenda.other_arms)
        return self._evidence.weights.of(first_sample, arm, is_guided=self.agenda.way.is_guided, is_part=is_part)

    def begin(self) -> None:
        self._evidence.remaining.begin()
        for question in self.agenda.questions:
            question.begin()

    def narrow(self, pixel_count: int, expected_paths: float) -> None:
        self._recording.budget.paths_per_sample = pixel_count
        self._evidence.remaining.expected_samples = expected_paths / max(self._context.pixel_count, 1)
        self._standing.is_narrow = is_narrow(pixel_count, self._context.pixel_count, self._context.rules)
        for question in self.agenda.questions:
            question.narrow(pixel_count, self._evidence.remaining.expected_samples)

    def rehearse(self) -> None:
        rng = np.random.default_rng(0)
        records = allocate_vertex_records(_REHEARSED_RECORDS, self._context.settings.channel_count)
        direction = rng.normal(size=(_REHEARSED_RECORDS, 3))
        records.position[:] = rng.random((_REHEARSED_RECORDS, 3))
        records.direction[:] = direction / np.linalg.norm(direction, axis=1)[:, None]
        records.normal[:] = (0.0, 0.0, 1.0)
        for column in (records.radiance, records.pdf, records.distance, records.roughness):
            column[:] = 1.0
        for learnable in self.learnables:
            learnable.rehearse(Rehearsal(records, _REHEARSED_RECORDS))
        for question in self.agenda.questions:
            question.rehearse(self._context.settings.channel_count)

    def first(self) -> Guidance:
        return self._guidance(self._recording.first())

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        self._evidence.observe(unit, film, self.agenda)
        self.agenda.observe(unit, film, self._costs.unit(costs, unit.arm, self.agenda.way_of(unit.arm).rung))

    def learn(self, traced: Traced) -> Guidance:
        iteration = self._evidence.iteration(traced, self.agenda, self._learning_seconds)
        self.agenda.conclude(iteration)
        if self._notes_loss():
            self._evidence.take_back()
        if not iteration.is_early:
            self._recording.count(iteration)
            self._learning_seconds = sum(self._learn(learnable, iteration) for learnable in self.learnables)
        self.agenda.plan(iteration)
        self._notes_loss()
        return self._guidance(self._recording.next(iteration, self.agenda))

    def _learn(self, learnable: Learnable, iteration: Iteration) -> float:
        """Have one learn; returns the seconds that guiding has to pay for."""
        if learnable.is_over:
            return 0.0
        self._learning_time.begin()
        learnable.learn(iteration)
        return self._learning_time.end() if learnable.serves_guiding else 0.0

    def _notes_loss(self) -> bool:
        """End what guided paths need, if guiding has just been given up; returns whether it has."""
        if not self._standing.is_over or self._rest is None:
            return False
        self._recording, self._rest = self._rest(self._recording.budget.paths_per_sample), None
        for learnable in self.learnables:
            learnable.stop()
        return True

    def _guidance(self, recording: Guidance) -> Guidance:
        """What the next iteration goes by, given what records."""
        guidance, challenger = self._complete(recording, self.agenda.way), self.agenda.challenger
        if challenger is None:
            return guidance
        return replace(guidance, challenger=self._complete(recording, challenger))

    def _complete(self, guidance: Guidance, way: Way) -> Guidance:
        for learnable in self.learnables:
            guidance = learnable.complete(guidance, way, self._evidence.image)
        return guidance

    def take_last(self, units: Sequence[UnitRecords]) -> None:
        if self._keeper is not None:
            self._keeper.take_last(units, self.agenda)

    def learned(self, light_digest: str) -> LearnedField | None:
        return None if self._keeper is None else self._keeper.learned(light_digest, self._recording)

    def close(self) -> None:
        self._context.executor.shutdown(wait=True)
        for learnable in self.learnables:
            learnable.close()
