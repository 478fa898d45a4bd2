# SPDX-License-Identifier: GPL-3.0-or-later
"""A source of directions that the engine knows nothing of: a cosine lobe about the normal.

`examples/add_source.py` renders by it. It shows what a source must have, and it is no good guide: it learns nothing,
and every material knows its normal. `engine/guiding/sources/guide_kernels.py` says what each part is for.

Stages compiled for its lanes are cached by the name of their class: who changes its kernels gives it another name.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.models.source_model import SourceModel
from engine.guiding.sources.guide_kernels import GuideKernels, ask_for_nothing, is_same_at_all, query_nothing
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.path import real_3
from engine.kernels.vector import dot, load, store
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.lanes import POINT_NS

_INVERSE_PI = np.float32(1.0 / np.pi)


class CosineGuide(Bundle):
    """normal : float32 (L, 3), unit, on the viewer's side."""

    normal: Float32Array


def allocate(settings: RenderSettings, lane_count: int) -> CosineGuide:
    """Lanes."""
    return CosineGuide(np.zeros((lane_count, 3), np.float32))


def make_model(settings: RenderSettings) -> SourceModel:
    """There is nothing to learn."""
    return SourceModel()


def target(settings: RenderSettings, *, is_diffuse: bool) -> str:
    """Under an even sky on a white wall."""
    return "PRODUCT"


@kernel
def _ready(guide, lane, field, region, points, closures, is_diffuse, bits):
    store(guide.normal, lane, real_3(points, lane, POINT_NS))
    return True


@kernel
def _ready_collision(guide, lane, field, region, points, closures, bits):
    store(guide.normal, lane, real_3(points, lane, POINT_NS))
    return True


@kernel
def _sample(guide, lane, u0, u1, u2):
    direction, _cosine = sample_cosine_hemisphere(load(guide.normal, lane), u0, u1)
    return direction


@kernel
def _eval(guide, lane, wi):
    return max(dot(load(guide.normal, lane), wi), 0.0) * _INVERSE_PI


@kernel
def _predict(guide, lane, wi, guide_pdf):
    return np.float32(1.0)


def _with_field(guide: CosineGuide, field: Any) -> CosineGuide:
    return guide


KERNELS = {
    CosineGuide: GuideKernels(
        _with_field, _ready, _ready_collision, _sample, _eval, _predict, is_same_at_all, query_nothing, ask_for_nothing
    )
}
