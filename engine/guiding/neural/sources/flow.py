# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from a normalizing flow (Müller et al. 2019)."""

from __future__ import annotations

import numpy as np

from engine.guiding.neural.models.network_source import NetworkDesign, NetworkSource
from engine.guiding.neural.networks.flow.field import (
    FlowField,
    FlowGuide,
    allocate_flow_guide,
    make_flow_field,
    no_flow_field,
)
from engine.guiding.neural.networks.flow.query import eval_flow, predict_flow, prepare_flow, sample_flow
from engine.guiding.neural.networks.flow.shape import FlowSettings, FlowShape
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.neural.sources.network import NETWORK_KERNELS, NetworkGuide, allocate_network_guide, with_network
from engine.guiding.sources.guide_kernels import GuideKernels, ask_for_nothing, is_same_at_all, query_nothing
from engine.kernels.bsdf import mean_roughness
from engine.kernels.bsdf.phase import phase_roughness
from engine.kernels.path import real_3
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.state.lanes import POINT_NS, POINT_P, POINT_WO


def design(settings: RenderSettings) -> NetworkDesign:
    """Shape and training of the flow."""
    shape = FlowShape()

    def make_field(snapshot: Snapshot, samples: float) -> FlowField:
        return make_flow_field(shape, snapshot)

    return NetworkDesign(shape, FlowSettings(), make_field, compensates_rows=settings.mis_compensation)


def make_model(settings: RenderSettings) -> NetworkSource:
    """What trains the flow."""
    return NetworkSource(settings, design(settings))


def allocate(settings: RenderSettings, lane_count: int) -> NetworkGuide:
    """Lanes for a flow that has learned nothing."""
    lanes = allocate_flow_guide(no_flow_field(FlowShape()), lane_count)
    return allocate_network_guide(lanes, lane_count, target(settings, is_diffuse=False))


def target(settings: RenderSettings, *, is_diffuse: bool) -> str:
    """What the flow is trained for."""
    return FlowSettings().target


@kernel
def _ready_flow(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The flow, on condition of the vertex."""
    prepare_flow(
        guide, lane, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), real_3(points, lane, POINT_WO),
        mean_roughness(closures, lane), field.fluence[region] if region >= 0 else np.float32(0.0),
    )
    return True



@kernel
def _ready_flow_collision(guide, lane, field, region, points, closures, bits):
    """The flow, on condition of the collision."""
    prepare_flow(
        guide, lane, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), real_3(points, lane, POINT_WO),
        phase_roughness(closures, lane), field.fluence[region] if region >= 0 else np.float32(0.0),
    )
    return True


KERNELS = {
    NetworkGuide: NETWORK_KERNELS,
    FlowGuide: GuideKernels(
        with_network, _ready_flow, _ready_flow_collision, sample_flow, eval_flow, predict_flow, is_same_at_all,
        query_nothing, ask_for_nothing,
    ),
}
