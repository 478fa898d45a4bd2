# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from a network; the mixture field stands in for it until its first snapshot, which takes seconds.

What is drawn in proportion to a product with the BSDF says nothing of the radiance alone: BSDFs that are dark where the
light comes from hide it. There the mixture field, which is fitted besides, predicts.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.array_types import Uint8Array
from engine.guiding.fields.vmm.field import GuideLobes, allocate_guide
from engine.guiding.fields.vmm.query import clear_vmm, eval_vmm, predict_vmm, sample_vmm
from engine.guiding.sources import kernels_of
from engine.guiding.sources.guide_kernels import GuideKernels, is_same_at_all, query_nothing
from engine.guiding.sources.vmm import ask_for_lobes, ready_vmm, ready_vmm_collision
from engine.runtime.bundle import Bundle
from engine.runtime.jit import by_bundle, kernel


class NetworkGuide(Bundle):
    """A network's lanes, and those of the mixture field for as long as there is no network.

    lanes : lanes of the network's kind, with a field `network`
    mixture : GuideLobes
    has_network : uint8 (1,)
    learns_product : uint8 (1,), 1 = the network's density is that of a product: the mixture field predicts
    """

    lanes: Bundle
    mixture: GuideLobes
    has_network: Uint8Array
    learns_product: Uint8Array


def allocate_network_guide(lanes: Bundle, lane_count: int, target: str) -> NetworkGuide:
    """Lanes for a network that has learned nothing.

    Parameters
    ----------
    target : str
        What its directions come closest to, 'RADIANCE' or 'PRODUCT'.
    """
    learns_product = np.full(1, target == "PRODUCT", np.uint8)
    return NetworkGuide(lanes, allocate_guide(lane_count), np.zeros(1, np.uint8), learns_product)


def with_network(lanes: Bundle, field: Any) -> Bundle:
    """The lanes of another network."""
    return lanes._replace(network=field)


def _with_field(guide: NetworkGuide, field: Any) -> NetworkGuide:
    """The lanes of a network, or of the mixture field."""
    has_network = np.full(1, field is not None, np.uint8)
    lanes = guide.lanes if field is None else with_network(guide.lanes, field)
    return guide._replace(lanes=lanes, has_network=has_network)


_ready_lanes = by_bundle(lambda lanes: kernels_of(lanes).ready, like=ready_vmm)
_ready_lanes_collision = by_bundle(lambda lanes: kernels_of(lanes).ready_collision, like=ready_vmm_collision)
_query_lanes = by_bundle(lambda lanes: kernels_of(lanes).query, like=query_nothing)
_ask_for_lanes = by_bundle(lambda lanes: kernels_of(lanes).ask, like=ask_for_lobes)
_eval_lanes = by_bundle(lambda lanes: kernels_of(lanes).eval, like=eval_vmm)
_eval_lane_wavelengths = by_bundle(lambda lanes: kernels_of(lanes).eval_wavelengths, like=is_same_at_all)
_sample_lanes = by_bundle(lambda lanes: kernels_of(lanes).sample, like=sample_vmm)
_predict_lanes = by_bundle(lambda lanes: kernels_of(lanes).predict, like=predict_vmm)


@kernel
def _ready_network(guide, lane, field, region, points, closures, is_diffuse, bits):
    """What the network will be asked with, or the region's mixture, or both."""
    is_early = guide.has_network[0] == 0
    if is_early or guide.learns_product[0] != 0:
        # What only predicts needs no cosine, which would be divided out again.
        has_cosine = is_diffuse and is_early
        is_known = ready_vmm(guide.mixture, lane, field, region, points, closures, has_cosine, bits)
        if is_early:
            return is_known
        if not is_known:
            clear_vmm(guide.mixture, lane)
    return _ready_lanes(guide.lanes, lane, field, region, points, closures, is_diffuse, bits)


@kernel
def _ready_network_collision(guide, lane, field, region, points, closures, bits):
    """The same at a collision; the phase function is divided out again where the mixture only predicts."""
    is_early = guide.has_network[0] == 0
    if is_early or guide.learns_product[0] != 0:
        is_known = ready_vmm_collision(guide.mixture, lane, field, region, points, closures, bits)
        if is_early:
            return is_known
        if not is_known:
            clear_vmm(guide.mixture, lane)
    return _ready_lanes_collision(guide.lanes, lane, field, region, points, closures, bits)


@kernel
def _query_network(guide, guided, paths, points, lanes, lane_count):
    """Ask the network, if there is one."""
    if guide.has_network[0] != 0:
        _query_lanes(guide.lanes, guided, paths, points, lanes, lane_count)


@kernel
def _ask_for_network(guide, lane):
    """Have a lane's distribution brought to the cache."""
    if guide.has_network[0] == 0:
        ask_for_lobes(guide.mixture, lane)
    else:
        _ask_for_lanes(guide.lanes, lane)


@kernel
def _eval_network(guide, lane, wi):
    """Density of `_sample_network`."""
    if guide.has_network[0] == 0:
        return eval_vmm(guide.mixture, lane, wi)
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
        return sample_vmm(guide.mixture, lane, u0, u1, u2)
    return _sample_lanes(guide.lanes, lane, u0, u1, u2)


@kernel
def _predict_network(guide, lane, wi, guide_pdf):
    """Radiance to expect by the network's distribution or the field's."""
    if guide.has_network[0] == 0:
        return predict_vmm(guide.mixture, lane, wi, guide_pdf)
    if guide.learns_product[0] != 0:
        return predict_vmm(guide.mixture, lane, wi, eval_vmm(guide.mixture, lane, wi))
    return _predict_lanes(guide.lanes, lane, wi, guide_pdf)


NETWORK_KERNELS = GuideKernels(
    _with_field, _ready_network, _ready_network_collision, _sample_network, _eval_network, _predict_network,
    _eval_network_wavelengths, _query_network, _ask_for_network,
)
