# SPDX-License-Identifier: GPL-3.0-or-later
"""The mixture field, and what is learned by its regions: how often to guide, and how often to sample lights."""

from __future__ import annotations

import time

from engine.array_types import Float32Array
from engine.guiding.fields.state import State
from engine.guiding.models.regions import RegionModels, without_surfaces
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.costs import MethodCosts
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import MEDIA, SURFACES, ImageState, Way
from engine.guiding.records.vertices import VertexRecords, compensate
from engine.guiding.saved.learned import LearnedField
from engine.ris.orca import make_allocation


class LearnedRegions(Learnable):
    """What is learned by region whatever the method.

    Parameters
    ----------
    context : RenderContext
    standing : Standing
    costs : MethodCosts
        They say what candidates cost, which are allotted by that.
    """

    def __init__(self, context: RenderContext, standing: Standing, costs: MethodCosts) -> None:
        self._context, self._standing, self._costs = context, standing, costs
        #: None while nothing is known.
        self.models: RegionModels | None = None
        #: Mean of what resampling saves by region; None: to be asked for.
        self._deltas: Float32Array | None = None
        #: Whether another view may have made them.
        self._is_resumed = False

    @property
    def is_over(self) -> bool:
        return self._standing.is_over

    @property
    def knows_media(self) -> bool:
        """Whether there were collisions with media to learn from."""
        return self.models is not None and self.models.knows_media

    @property
    def promises(self) -> tuple[float, float]:
        """What regions promise of guiding surfaces and media, 1 where nothing is known."""
        return (1.0, 1.0) if self.models is None else self.models.promises

    def resume(self, start: LearnedField) -> None:
        """Take over what another render has learned.

        Raises
        ------
        StateError
            If the arrays are no state of such models.
        """
        self._take(RegionModels.of_state(start.state, self._context.settings.guiding_probability, start.field))
        self._is_resumed = True

    def _take(self, models: RegionModels) -> None:
        self.models = models
        if self._context.light_clusters is not None:
            models.begin_light_selection(self._context.light_clusters)

    def learn(self, iteration: Iteration) -> None:
        if iteration.row_count:
            self.fit(iteration.records, iteration.row_count, iteration.image, was_guided=iteration.was_guided)

    def fit(self, records: VertexRecords, row_count: int, image: ImageState, *, was_guided: bool) -> None:
        """Fit the mixture field to records, and learn by its regions what they say.

        Parameters
        ----------
        records : VertexRecords
        row_count : int
        image : ImageState
        was_guided : bool
            Whether the paths were guided.
        """
        context, started = self._context, time.perf_counter()
        probability = context.settings.guiding_probability
        # Records of the field alone; distances are cut in place, for all who learn after it.
        batch = compensate(records, row_count, probability) if context.settings.mis_compensation else records
        if self.models is None:
            self._take(RegionModels.of_records(batch, row_count, probability))
        elif self._is_resumed:
            self.models.widen(batch, row_count)
        self._is_resumed = False
        models = self.models
        assert models is not None
        models.fit(batch, row_count, context.executor, context.thread_count)
        report, field = context.report, models.field
        report.region_count = len(field.is_ready)
        report.unsound_count = int(models.mixture.report()["regions_unsound"])
        report.lobe_count = float(field.lobe_count.mean())
        report.field_seconds += (time.perf_counter() - started) * context.thread_count
        models.add_deltas(records, row_count)
        models.learn_shares(
            records, row_count, variance=image.variance, ray_count=image.ray_count, was_guided=was_guided
        )
        self._deltas = None

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        models, settings = self.models, self._context.settings
        if models is None or not way.is_guided:
            return guidance
        probability = models.probability(is_learned=settings.learn_guiding_probability)
        report, ready = self._context.report, models.field.is_ready != 0
        of_surfaces, of_media = probability[: len(ready)], probability[len(ready) :]
        report.guided_share = float((of_surfaces[ready] > 0.0).sum() / max(ready.sum(), 1))
        if len(of_media):
            report.guided_media_share = float((of_media[ready] > 0.0).sum() / max(ready.sum(), 1))
        if self._deltas is None:
            self._deltas = models.variance_deltas()
        allocation = make_allocation(
            self._deltas, ray_count=image.ray_count, variance=image.variance,
            costs=self._costs.candidates(way.rung),
        )
        return guidance.with_regions(
            models.field, without_surfaces(probability, len(ready)) if way.guides == MEDIA else probability,
            models.light_share.share, models.selection.benefit, allocation, image.weights,
            guides_media=way.guides != SURFACES,
        )

    def state(self) -> State:
        return {} if self.models is None else self.models.state()

    def rehearse(self, rehearsal: Rehearsal) -> None:
        models = rehearsed_regions(rehearsal)
        if self._context.light_clusters is not None:
            models.begin_light_selection(self._context.light_clusters)
        models.learn_shares(
            rehearsal.records, rehearsal.row_count, variance=1.0, ray_count=1.0, was_guided=True
        )


def rehearsed_regions(rehearsal: Rehearsal) -> RegionModels:
    """Regions that have learned from nothing in particular."""
    models = RegionModels.of_records(rehearsal.records, rehearsal.row_count, 0.5)
    models.fit(rehearsal.records, rehearsal.row_count)
    return models
