# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from the mixture field, which every guided render fits for its regions."""

from __future__ import annotations

from typing import Any

from engine.guiding.fields.vmm.field import GUIDE_LINES, GuideLobes, allocate_guide
from engine.guiding.fields.vmm.query import eval_vmm, predict_vmm, prepare_phase, prepare_vmm, sample_vmm
from engine.guiding.sources.guide_kernels import GuideKernels, is_same_at_all, query_nothing
from engine.kernels.bsdf.phase import mean_cosine
from engine.kernels.path import real_3
from engine.kernels.prefetch import prefetch_lines
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.lanes import POINT_NS, POINT_P


def allocate(settings: RenderSettings, lane_count: int) -> GuideLobes:
    """Lanes that have learned nothing."""
    return allocate_guide(lane_count)


def make_model(settings: RenderSettings) -> None:
    """None: the field is fitted anyway."""


def target(settings: RenderSettings, *, is_diffuse: bool) -> str:
    """The cosine is multiplied in where the surface is diffuse, where that is the product."""
    return "PRODUCT" if is_diffuse else "RADIANCE"


@kernel
def ready_vmm(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The region's mixture, as seen from the vertex."""
    if region < 0:
        return False
    prepare_vmm(field, region, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), is_diffuse, guide, lane)
    return True


@kernel
def ready_vmm_collision(guide, lane, field, region, points, closures, bits):
    """The region's mixture, as seen from the collision, times a lobe in the phase functions' place."""
    if region < 0:
        return False
    forward = real_3(points, lane, POINT_NS)
    prepare_phase(field, region, real_3(points, lane, POINT_P), forward, mean_cosine(closures, lane), guide, lane)
    return True


@kernel
def ask_for_lobes(guide, lane):
    """Have a lane's lobes brought to the cache."""
    prefetch_lines(guide.lobes, lane, GUIDE_LINES)


def _with_field(guide: GuideLobes, field: Any) -> GuideLobes:
    """The lanes as they are: the field comes with the guidance."""
    return guide


KERNELS = {
    GuideLobes: GuideKernels(
        _with_field, ready_vmm, ready_vmm_collision, sample_vmm, eval_vmm, predict_vmm, is_same_at_all, query_nothing,
        ask_for_lobes,
    )
}
