# SPDX-License-Identifier: GPL-3.0-or-later
"""What stages sample by, whichever field has learned it: one face for all, chosen when a stage is compiled.

A guide is a bundle of lanes. `ready_guide` says for a lane whether there is anything to sample by; once that has been
asked of all lanes of a round, `query_guides` does what is better done for many at once. Then `eval_guide` is the
density of `sample_guide`, and `predict_guide` says what radiance to expect from a direction. Until a network's first
snapshot, which takes seconds, the mixture field stands in for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.bundle import Bundle
from engine.guiding.flow.field import FlowField, FlowGuide, allocate_flow_guide, no_flow_field
from engine.guiding.flow.query import eval_flow, predict_flow, prepare_flow, sample_flow
from engine.guiding.flow.shape import FlowShape
from engine.guiding.mixture.guide import (
    MixtureGuide,
    allocate_mixture_guide,
    ask_for_mixture,
    eval_mixture,
    eval_mixture_wavelengths,
    predict_mixture,
    query_mixtures,
    sample_mixture,
)
from engine.guiding.mixture.inference import MixtureNetwork
from engine.guiding.sdtree.field import SdTreeField, SdTreeGuide, allocate_sdtree_guide, no_sdtree_field
from engine.guiding.sdtree.query import (
    eval_sdtree,
    look_up_sdtree,
    predict_sdtree,
    prepare_sdtree_guide,
    sample_sdtree,
)
from engine.guiding.sources import source_shape
from engine.guiding.vmm.field import GUIDE_LINES, GuideLobes, allocate_guide
from engine.guiding.vmm.query import eval_vmm, predict_vmm, prepare_vmm, sample_vmm
from engine.jit import by_bundle, kernel
from engine.kernels.bsdf import mean_roughness
from engine.kernels.path import real_3
from engine.kernels.prefetch import prefetch_lines
from engine.scene.arrays import Uint8Array
from engine.settings import RenderSettings
from engine.state import POINT_NS, POINT_P, POINT_WO, WAVELENGTHS

#: What an iteration may have learned to sample by, besides the statistical mixtures.
SourceField = SdTreeField | MixtureNetwork | FlowField


class NetworkGuide(Bundle):
    """A network's lanes, and those of the mixture field for as long as there is no network.

    lanes : MixtureGuide or FlowGuide
    early : GuideLobes
    has_network : uint8 (1,)
    """

    lanes: Bundle
    early: GuideLobes
    has_network: Uint8Array


def allocate_guide_of(settings: RenderSettings, lane_count: int) -> Any:
    """Lanes for the source of directions that the settings ask for; it has learned nothing."""
    if settings.source in ("SDTREE", "SDTREE_VARIANCE"):
        return allocate_sdtree_guide(lane_count, no_sdtree_field())
    early = allocate_guide(lane_count)
    if settings.source == "VMM":
        return early
    shape = source_shape(settings)
    lanes: Bundle
    if isinstance(shape, FlowShape):
        lanes = allocate_flow_guide(no_flow_field(shape), lane_count)
    else:
        sees_wavelength = settings.u_dimension == "WAVELENGTH" and shape.sees_u
        lanes = allocate_mixture_guide(shape, lane_count, WAVELENGTHS if sees_wavelength else 1)
    return NetworkGuide(lanes, early, np.zeros(1, np.uint8))


def with_field(guide: Any, field: SourceField | None) -> Any:
    """The same lanes for what has been learned; None: nothing but the mixture field."""
    if isinstance(guide, SdTreeGuide):
        return guide._replace(tree=no_sdtree_field() if field is None else field)
    if isinstance(guide, NetworkGuide):
        has_network = np.full(1, field is not None, np.uint8)
        lanes = guide.lanes if field is None else guide.lanes._replace(network=field)
        return guide._replace(lanes=lanes, has_network=has_network)
    return guide


@kernel
def _ready_vmm(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The region's mixture, as seen from the vertex."""
    if region < 0:
        return False
    prepare_vmm(field, region, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), is_diffuse, guide, lane)
    return True


@kernel
def _ready_sdtree(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The quadtree of a cell near the vertex."""
    cell = look_up_sdtree(guide.tree, real_3(points, lane, POINT_P), bits, True)
    if cell < 0:
        return False
    prepare_sdtree_guide(guide, lane, cell)
    return True


@kernel
def _ready_mixture(guide, lane, field, region, points, closures, is_diffuse, bits):
    """What the network will be asked with."""
    guide.fluence[lane] = field.fluence[region] if region >= 0 else np.float32(0.0)
    guide.roughness[lane] = mean_roughness(closures, lane)
    guide.is_diffuse[lane] = 1 if is_diffuse else 0
    return True


@kernel
def _ready_flow(guide, lane, field, region, points, closures, is_diffuse, bits):
    """The flow, on condition of the vertex."""
    prepare_flow(
        guide, lane, real_3(points, lane, POINT_P), real_3(points, lane, POINT_NS), real_3(points, lane, POINT_WO),
        mean_roughness(closures, lane), field.fluence[region] if region >= 0 else np.float32(0.0),
    )
    return True


@kernel
def _query_nothing(guide, guided, paths, points, lanes, lane_count):
    """Lanes that were made ready one by one."""


@kernel
def _is_same_at_all(guide, lane, wi, out, row, column):
    """A distribution that knows no wavelengths."""
    return False


@kernel
def _ask_for_lobes(guide, lane):
    """Have a lane's lobes brought to the cache."""
    prefetch_lines(guide.lobes, lane, GUIDE_LINES)


@kernel
def _ask_for_nothing(guide, lane):
    """A lane whose data are few, or not known ahead."""


_ready_lanes = by_bundle({MixtureGuide: _ready_mixture, FlowGuide: _ready_flow})
_query_lanes = by_bundle({MixtureGuide: query_mixtures, FlowGuide: _query_nothing})
_ask_for_lanes = by_bundle({MixtureGuide: ask_for_mixture, FlowGuide: _ask_for_nothing})
_eval_lanes = by_bundle({MixtureGuide: eval_mixture, FlowGuide: eval_flow})
_eval_lane_wavelengths = by_bundle({MixtureGuide: eval_mixture_wavelengths, FlowGuide: _is_same_at_all})
_sample_lanes = by_bundle({MixtureGuide: sample_mixture, FlowGuide: sample_flow})
_predict_lanes = by_bundle({MixtureGuide: predict_mixture, FlowGuide: predict_flow})


@kernel
def _ready_network(guide, lane, field, region, points, closures, is_diffuse, bits):
    """What the network will be asked with, or the region's mixture."""
    if guide.has_network[0] == 0:
        return _ready_vmm(guide.early, lane, field, region, points, closures, is_diffuse, bits)
    return _ready_lanes(guide.lanes, lane, field, region, points, closures, is_diffuse, bits)


@kernel
def _query_network(guide, guided, paths, points, lanes, lane_count):
    """Ask the network, if there is one."""
    if guide.has_network[0] != 0:
        _query_lanes(guide.lanes, guided, paths, points, lanes, lane_count)


@kernel
def _ask_for_network(guide, lane):
    """Have a lane's distribution brought to the cache."""
    if guide.has_network[0] == 0:
        _ask_for_lobes(guide.early, lane)
    else:
        _ask_for_lanes(guide.lanes, lane)


@kernel
def _eval_network(guide, lane, wi):
    """Density of `_sample_network`."""
    if guide.has_network[0] == 0:
        return eval_vmm(guide.early, lane, wi)
    return _eval_lanes(guide.lanes, lane, wi)


@kernel
def _eval_network_wavelengths(guide, lane, wi, out, row, column):
    """Densities of the network's distribution by wavelength, if it knows them."""
    if guide.has_network[0] == 0:
        return False
    return _eval_lane_wavelengths(guide.lanes, lane, wi, out, row, column)


@kernel
def _sample_network(guide, lane, u0, u1, u2):
    """Draw a direction from the network's distribution or the field's."""
    if guide.has_network[0] == 0:
        return sample_vmm(guide.early, lane, u0, u1, u2)
    return _sample_lanes(guide.lanes, lane, u0, u1, u2)


@kernel
def _predict_network(guide, lane, wi, guide_pdf):
    """Radiance to expect by the network's distribution or the field's."""
    if guide.has_network[0] == 0:
        return predict_vmm(guide.early, lane, wi, guide_pdf)
    return _predict_lanes(guide.lanes, lane, wi, guide_pdf)


#: (guide, lane, field, region, points, closures, is_diffuse, bits) -> bool: make a lane ready to be sampled, if it can.
#: `field` and `region` are of the mixture field (-1: it knows nothing here), `bits` random.
ready_guide = by_bundle({GuideLobes: _ready_vmm, SdTreeGuide: _ready_sdtree, NetworkGuide: _ready_network})
#: (guide, guided, paths, points, lanes, lane_count): make all lanes ready that `ready_guide` has agreed to.
query_guides = by_bundle({GuideLobes: _query_nothing, SdTreeGuide: _query_nothing, NetworkGuide: _query_network})
#: (guide, lane): have a lane's data brought to the cache.
ask_for_guide = by_bundle({GuideLobes: _ask_for_lobes, SdTreeGuide: _ask_for_nothing, NetworkGuide: _ask_for_network})
#: (guide, lane, wi) -> float32 [sr^-1]: density of `sample_guide`.
eval_guide = by_bundle({GuideLobes: eval_vmm, SdTreeGuide: eval_sdtree, NetworkGuide: _eval_network})
#: (guide, lane, wi, out, row, column) -> bool: whether the density depends on the wavelength. If so, those of all the
#: path's wavelengths, had each been the hero, are written to `out`; `eval_guide` is their mean by their shares.
eval_wavelengths = by_bundle(
    {GuideLobes: _is_same_at_all, SdTreeGuide: _is_same_at_all, NetworkGuide: _eval_network_wavelengths}
)
#: (guide, lane, u0, u1, u2) -> unit direction.
sample_guide = by_bundle({GuideLobes: sample_vmm, SdTreeGuide: sample_sdtree, NetworkGuide: _sample_network})
#: (guide, lane, wi, guide_pdf) -> float32: incident radiance along wi, mean over channels.
predict_guide = by_bundle({GuideLobes: predict_vmm, SdTreeGuide: predict_sdtree, NetworkGuide: _predict_network})
