# SPDX-License-Identifier: GPL-3.0-or-later
"""Which lights regions sample: those of the mixture field, or of a tree of their own where nothing is guided."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from engine.guiding.fields.update import make_runner
from engine.guiding.fields.vmm.leaves import find_leaves
from engine.guiding.fields.vmm.regions import RegionTree
from engine.guiding.models.light_selection import LightSelectionModel
from engine.guiding.policy.context import RenderContext
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iteration import Iteration
from engine.guiding.policy.learnables.learnable import Learnable, Rehearsal
from engine.guiding.policy.learnables.regions import LearnedRegions
from engine.guiding.policy.standing import Standing
from engine.guiding.policy.way import ImageState, Way
from engine.guiding.records.vertices import VertexRecords, as_records
from engine.state.lights import LightSelection, no_selection


class LightsOfRegions(Learnable):
    """Which lights the regions of the mixture field sample. They are learned on once guiding has lost.

    Parameters
    ----------
    context : RenderContext
        With clusters of lights.
    standing : Standing
    regions : LearnedRegions
    """

    def __init__(self, context: RenderContext, standing: Standing, regions: LearnedRegions) -> None:
        self._context, self._standing, self._regions = context, standing, regions
        #: None: nothing is learned about them any more.
        self._selection: LightSelection | None = no_selection()

    @property
    def is_over(self) -> bool:
        # A radiance cache learns alone.
        return self._standing.is_over and self._context.settings.radiance_cache != "OFF"

    @property
    def pays(self) -> bool:
        """Whether any region chooses by what it has learned."""
        return self._selection is not None and self._context.report.lights_share > 0.0

    def learn(self, iteration: Iteration) -> None:
        models = self._regions.models
        if models is None:
            return
        if self._standing.is_over:
            if not iteration.row_count:
                return
            models.learn_lights(iteration.records, iteration.row_count)
        self._selection = models.choose_lights()
        self._context.report.lights_share = models.lights_share

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        return replace(guidance, lights=self._selection)


class LightsAlone(Learnable):
    """Which lights regions sample, where there are no regions but those for it.

    Parameters
    ----------
    context : RenderContext
        With clusters of lights.
    """

    def __init__(self, context: RenderContext) -> None:
        assert context.light_clusters is not None
        self._report, self._is_possible = context.report, context.light_clusters
        self._lights = LightsByRegion(context.light_clusters)

    @property
    def pays(self) -> bool:
        """Whether any region chooses by what it has learned."""
        return self._lights.share > 0.0

    def learn(self, iteration: Iteration) -> None:
        started = time.perf_counter()
        self._lights.learn(iteration.records, iteration.row_count)
        self._report.lights_share = self._lights.share
        self._report.field_seconds += time.perf_counter() - started

    def complete(self, guidance: Guidance, way: Way, image: ImageState) -> Guidance:
        return replace(guidance, lights=self._lights.selection)

    def rehearse(self, rehearsal: Rehearsal) -> None:
        LightsByRegion(self._is_possible).learn(rehearsal.records, rehearsal.row_count)


class LightsByRegion:
    """Which lights regions sample, where there are no regions but those for it.

    Parameters
    ----------
    is_possible : bool (C,)
        Which of the scene's clusters of lights can be sampled at all.

    Attributes
    ----------
    selection : LightSelection
        What kernels choose by.
    """

    def __init__(self, is_possible: npt.NDArray[np.bool_]) -> None:
        self._is_possible = is_possible
        self._regions: RegionTree | None = None
        self._model = LightSelectionModel(is_possible)
        self.selection: LightSelection = no_selection()

    @property
    def share(self) -> float:
        """Share of the regions that choose by what they have learned."""
        return self._model.share

    def learn(self, records: VertexRecords, row_count: int) -> None:
        """Take an iteration's records."""
        if not row_count:
            return
        position = records.position[:row_count]
        if self._regions is None:
            self._regions = RegionTree(np.stack([position.min(axis=0), position.max(axis=0)]))
        regions = self._regions
        regions.update(as_records(records), row_count, make_runner(None, 1))
        leaf = np.full(row_count, -1, np.int32)
        find_leaves(regions.published, position, leaf)
        self._model.update(regions, records, leaf)
        self.selection = self._model.selection(regions)
