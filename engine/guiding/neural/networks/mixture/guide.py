# SPDX-License-Identifier: GPL-3.0-or-later
"""Lanes that sample the mixtures of a network: asked for many vertices at once, after it is known which are guided."""

from __future__ import annotations

import numpy as np

from engine.array_types import Float32Array, Int32Array, Uint8Array
from engine.guiding.fields.vmm.field import GUIDE_LINES, GuideLobes, allocate_guide
from engine.guiding.fields.vmm.query import eval_vmm, predict_vmm, sample_vmm
from engine.guiding.neural.networks.lobes.nasg import (
    NasgLobes,
    allocate_nasg,
    decode_nasg,
    eval_nasg,
    predict_nasg,
    sample_nasg,
)
from engine.guiding.neural.networks.lobes.vmf import decode_vmf, multiply_cosine
from engine.guiding.neural.networks.mixture.inference import (
    HEADER_HAS_COSINE,
    HEADER_LOBE_COUNT,
    HEADER_SELECTION,
    MixtureNetwork,
    allocate_mixture_scratch,
    evaluate_mixtures,
    no_mixture_network,
    selection_probability,
    u_of_time,
)
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.perceptron import CHUNK_ROWS
from engine.kernels.path import real_3
from engine.kernels.prefetch import ask_for_point, lane_ahead, prefetch_lines
from engine.kernels.vector import store
from engine.runtime.bundle import Bundle
from engine.runtime.jit import by_bundle, kernel
from engine.spectral.wavelengths import rotate_hero
from engine.state.lanes import POINT_NS, POINT_P, POINT_TIME, POINT_WO

#: The BSDF covers what a network has not seen: it keeps this share of the directions at least.
_MOST_GUIDED = np.float32(0.95)


class MixtureGuide(Bundle):
    """Mixtures of a network at the lanes' vertices, L lanes; S of them for each.

    One, or one for each of the path's wavelengths (Wilkie et al. 2014): the hero's, which is the first, is sampled, and
    the density is the mean of all, by their shares.

    network : MixtureNetwork
    lobes : GuideLobes or NasgLobes, row S * lane + slot
    share : float32 (L, S), of each wavelength in the path's density, see `state.PathState`; (0, S) of one
    fluence : float32 (L,), incident radiance (mean over channels) integrated over all directions
    roughness : float32 (L,), of the surface, in [0, 1]
    is_diffuse : uint8 (L,), whether every rough lobe of the BSDF is a diffuse reflection
    chunk_lane : int32 (CHUNK_ROWS,); chunk_position, chunk_normal, chunk_wo : float32 (CHUNK_ROWS, 3);
        chunk_roughness, chunk_u : float32 (CHUNK_ROWS,); scratch, raw : what the network is asked for, one thread's
    chunk_slot : int32 (CHUNK_ROWS,)
    slots : tuple of ints, its length is S
    """

    network: MixtureNetwork
    lobes: Bundle
    fluence: Float32Array
    roughness: Float32Array
    is_diffuse: Uint8Array
    chunk_lane: Int32Array
    chunk_position: Float32Array
    chunk_normal: Float32Array
    chunk_wo: Float32Array
    chunk_roughness: Float32Array
    chunk_u: Float32Array
    scratch: Float32Array
    raw: Float32Array
    share: Float32Array
    chunk_slot: Int32Array
    slots: tuple[int, ...]


def allocate_mixture_guide(shape: MixtureShape, lane_count: int, slot_count: int = 1) -> MixtureGuide:
    """Lanes for networks of a shape; for a new one `_replace(network=...)`.

    Parameters
    ----------
    slot_count : int
        Mixtures of a lane: 1, or WAVELENGTHS.
    """
    rows = lane_count * slot_count
    lobes: Bundle = allocate_guide(rows) if shape.lobe_model == "VMF" else allocate_nasg(rows, shape.lobe_count)

    def vectors() -> Float32Array:
        return np.zeros((CHUNK_ROWS, 3), np.float32)

    return MixtureGuide(
        no_mixture_network(shape), lobes, np.zeros(lane_count, np.float32), np.zeros(lane_count, np.float32),
        np.zeros(lane_count, np.uint8), np.zeros(CHUNK_ROWS, np.int32), vectors(), vectors(), vectors(),
        np.zeros(CHUNK_ROWS, np.float32), np.zeros(CHUNK_ROWS, np.float32), allocate_mixture_scratch(shape),
        np.zeros((CHUNK_ROWS, shape.output_width), np.float32),
        np.zeros((lane_count if slot_count > 1 else 0, slot_count), np.float32), np.zeros(CHUNK_ROWS, np.int32),
        tuple(range(slot_count)),
    )


@kernel
def _leave(lobes, lane, n):
    """A product with the cosine that this model of lobe has no closed form for."""


@kernel
def _ask_for_vmf(lobes, lane):
    """Have a lane's lobes brought to the cache."""
    prefetch_lines(lobes.lobes, lane, GUIDE_LINES)


@kernel
def _ask_for_nasg(lobes, lane):
    """Have a lane's lobes brought to the cache."""
    prefetch_lines(lobes.lobes, lane, _NASG_LINES)


#: Cache lines of ten rows of eight lobes.
_NASG_LINES = 5

_eval = by_bundle({GuideLobes: eval_vmm, NasgLobes: eval_nasg})
_sample = by_bundle({GuideLobes: sample_vmm, NasgLobes: sample_nasg})
_predict = by_bundle({GuideLobes: predict_vmm, NasgLobes: predict_nasg})
_decode = by_bundle({GuideLobes: decode_vmf, NasgLobes: decode_nasg}, argument=4)
_multiply_cosine = by_bundle({GuideLobes: multiply_cosine, NasgLobes: _leave})
_ask_for_lobes = by_bundle({GuideLobes: _ask_for_vmf, NasgLobes: _ask_for_nasg})


@kernel
def ask_for_mixture(guide, lane):
    """Have a lane's mixture, or the hero's, brought to the cache."""
    _ask_for_lobes(guide.lobes, lane * len(guide.slots))


@kernel
def eval_mixture(guide, lane, wi):
    """Density of `sample_mixture` at unit direction wi: float32 [sr^-1]."""
    count = len(guide.slots)
    if count == 1:
        return _eval(guide.lobes, lane, wi)
    pdf = np.float32(0.0)
    for slot in range(count):
        share = guide.share[lane, slot]
        if share > 0.0:
            pdf += share * _eval(guide.lobes, lane * count + slot, wi)
    return pdf


@kernel
def eval_mixture_wavelengths(guide, lane, wi, out, row, column):
    """Whether there is a mixture for each wavelength; if so, write their densities at wi.

    Parameters
    ----------
    out : float32 (R, at least column + S) [sr^-1]
        Row `row` is written from `column` on; 0 for wavelengths without a share in the path.
    """
    count = len(guide.slots)
    if count == 1:
        return False
    for slot in range(count):
        is_asked = guide.share[lane, slot] > 0.0
        out[row, column + slot] = _eval(guide.lobes, lane * count + slot, wi) if is_asked else np.float32(0.0)
    return True


@kernel
def sample_mixture(guide, lane, u0, u1, u2):
    """Draw a unit direction from a lane's mixture, or the hero's, by three numbers in [0, 1): float32 tuple."""
    return _sample(guide.lobes, lane * len(guide.slots), u0, u1, u2)


@kernel
def predict_mixture(guide, lane, wi, guide_pdf):
    """Incident radiance (mean over channels) along wi; for mixtures that are proportional to it, not to a product."""
    return _predict(guide.lobes, lane * len(guide.slots), wi, guide_pdf)


@kernel
def query_mixtures(guide, guided, paths, points, lanes, lane_count):
    """Ask the network for the mixtures of all guided lanes among `lanes`, and ready them.

    Parameters
    ----------
    guide : MixtureGuide
        With `fluence`, `roughness` and `is_diffuse` of the guided lanes.
    guided : GuidedLanes
        `probability` is the network's own where it has learned one.
    """
    network = guide.network
    lobe_count = network.header[HEADER_LOBE_COUNT]
    slot_count = len(guide.slots)
    k = 0
    while k < lane_count:
        count = 0
        while k < lane_count and count <= CHUNK_ROWS - slot_count:
            lane = lanes[k]
            ask_for_point(points, lane_ahead(lanes, k, lane_count))
            k += 1
            if guided.rough_share[lane] > 0.0:
                for slot in range(slot_count):
                    u = u_of_time(network, points.real[lane, POINT_TIME])
                    if slot_count > 1:
                        guide.share[lane, slot] = paths.share[lane, slot]
                        if not paths.share[lane, slot] > 0.0:
                            continue
                        u = rotate_hero(paths.hero[lane], slot)
                    guide.chunk_lane[count] = lane
                    guide.chunk_slot[count] = slot
                    store(guide.chunk_position, count, real_3(points, lane, POINT_P))
                    store(guide.chunk_normal, count, real_3(points, lane, POINT_NS))
                    store(guide.chunk_wo, count, real_3(points, lane, POINT_WO))
                    guide.chunk_roughness[count] = guide.roughness[lane]
                    guide.chunk_u[count] = u
                    count += 1
        evaluate_mixtures(
            network, guide.chunk_position, guide.chunk_normal, guide.chunk_wo, guide.chunk_roughness, guide.chunk_u,
            count, guide.scratch, guide.raw,
        )
        for row in range(count):
            lane = np.int64(guide.chunk_lane[row])
            row_slot = np.int64(guide.chunk_slot[row])
            lobes_row = lane * slot_count + row_slot
            _decode(guide.raw, row, 0, lobe_count, guide.lobes, lobes_row, guide.fluence[lane])
            if network.header[HEADER_HAS_COSINE] == 0 and guide.is_diffuse[lane] != 0:
                _multiply_cosine(guide.lobes, lobes_row, real_3(points, lane, POINT_NS))
            if network.header[HEADER_SELECTION] >= 0:
                probability = min(selection_probability(network, guide.raw, row), _MOST_GUIDED)
                if slot_count > 1:
                    # One for all wavelengths, or their densities would not be those of the same choices. A lane's rows
                    # are in one chunk, the hero's first.
                    probability *= guide.share[lane, row_slot]
                    if row_slot > 0:
                        probability += guided.probability[lane]
                guided.probability[lane] = min(probability, _MOST_GUIDED)
