# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from an SD-tree, plain (Müller et al. 2017) or variance-aware (Rath et al. 2020)."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np

from engine.guiding.fields.sdtree.field import SdTreeField, SdTreeGuide, allocate_sdtree_guide, no_sdtree_field
from engine.guiding.fields.sdtree.model import SdTreeModel
from engine.guiding.fields.sdtree.query import (
    eval_sdtree,
    look_up_sdtree,
    predict_sdtree,
    prepare_sdtree_guide,
    sample_sdtree,
)
from engine.guiding.models.source_model import SourceModel
from engine.guiding.records.vertices import VertexRecords, compensate
from engine.guiding.sources.guide_kernels import GuideKernels, ask_for_nothing, is_same_at_all, query_nothing
from engine.kernels.path import real_3
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.lanes import POINT_P

#: Records that a cell holds before it is cut, times the root of the passes: the authors' figure for passes of one
#: sample, which our records, thinned as they are, come closest to (docs/decisions/trees-and-neural-mixtures.md).
_PLAIN_THRESHOLD = 4000.0
#: Rath et al. 2020's sizes of the variance-aware tree: finer in space and in direction than the plain one.
_VARIANCE_THRESHOLD = 2000.0
_VARIANCE_FLUX_SHARE = 0.005


class TreeSource(SourceModel):
    """An SD-tree, learned between iterations.

    Parameters
    ----------
    settings : RenderSettings
    is_variance_aware : bool
    """

    def __init__(self, settings: RenderSettings, *, is_variance_aware: bool) -> None:
        super().__init__()
        self._settings = settings
        self._is_variance_aware = is_variance_aware
        self._model: SdTreeModel | None = None

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        if row_count == 0:
            return
        if self._model is None:
            position = records.position[:row_count]
            bounds = np.stack([position.min(axis=0), position.max(axis=0)])
            if self._is_variance_aware:
                self._model = SdTreeModel(
                    bounds, spatial_threshold=_VARIANCE_THRESHOLD, flux_share=_VARIANCE_FLUX_SHARE,
                    is_variance_aware=True, seed=self._settings.seed,
                )  # fmt: skip
            else:
                self._model = SdTreeModel(bounds, spatial_threshold=_PLAIN_THRESHOLD, seed=self._settings.seed)
        if self._settings.mis_compensation:
            records = compensate(records, row_count, self._settings.guiding_probability)
        # The paper's thresholds are for paths that all leave records.
        self._model.update(records, row_count, samples * recorded_share, executor, thread_count)
        self.field = self._model.field

    def rehearse(self, records: VertexRecords, row_count: int, executor: ThreadPoolExecutor) -> None:
        another = TreeSource(self._settings, is_variance_aware=self._is_variance_aware)
        another.learn(records, row_count, 1.0, 1.0, executor, 1)

    def describe(self) -> str:
        return "" if self._model is None else f"SD-tree: {self._model.region_count} regions"


def allocate(settings: RenderSettings, lane_count: int) -> SdTreeGuide:
    """Lanes for a tree that has learned nothing."""
    return allocate_sdtree_guide(lane_count, no_sdtree_field())


def make_model(settings: RenderSettings) -> TreeSource:
    """What learns the tree."""
    return TreeSource(settings, is_variance_aware=_is_variance_aware(settings))


def target(settings: RenderSettings, *, is_diffuse: bool) -> str:
    """A variance-aware tree learns the root of the product's second moment."""
    return "PRODUCT" if _is_variance_aware(settings) else "RADIANCE"


def _is_variance_aware(settings: RenderSettings) -> bool:
    return settings.source == "SDTREE_VARIANCE"


@kernel
def _ready_sdtree(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The quadtree of a cell near the vertex."""
    cell = look_up_sdtree(guide.tree, real_3(points, lane, POINT_P), bits, True)
    if cell < 0:
        return False
    prepare_sdtree_guide(guide, lane, cell)
    return True


@kernel
def _ready_sdtree_collision(guide, lane, field, region, points, closures, bits):
    """The same as on surfaces: the tree is multiplied with nothing."""
    return _ready_sdtree(guide, lane, field, region, points, closures, False, bits)


def _with_field(guide: SdTreeGuide, field: SdTreeField | None) -> SdTreeGuide:
    """The lanes of a tree, or of one that knows nothing."""
    return guide._replace(tree=no_sdtree_field() if field is None else field)


KERNELS = {
    SdTreeGuide: GuideKernels(
        _with_field, _ready_sdtree, _ready_sdtree_collision, sample_sdtree, eval_sdtree, predict_sdtree,
        is_same_at_all, query_nothing, ask_for_nothing,
    )
}
