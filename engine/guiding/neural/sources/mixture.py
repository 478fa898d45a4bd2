# SPDX-License-Identifier: GPL-3.0-or-later
"""Directions from neural mixtures: NPM (Dong et al. 2023) and NASG (Huang et al. 2024), as the settings shape them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from engine.guiding.neural.models.network_source import NetworkDesign, NetworkSource
from engine.guiding.neural.networks.mixture.guide import (
    MixtureGuide,
    allocate_mixture_guide,
    ask_for_mixture,
    eval_mixture,
    eval_mixture_wavelengths,
    predict_mixture,
    query_mixtures,
    sample_mixture,
)
from engine.guiding.neural.networks.mixture.inference import MixtureNetwork, make_mixture_network
from engine.guiding.neural.networks.mixture.shape import (
    NASG,
    NASG_COSINE,
    NASG_PRODUCT,
    NASG_SETTINGS,
    NPM,
    NPM_OFFICIAL,
    NPM_OFFICIAL_SETTINGS,
    NPM_PRODUCT,
    NPM_SETTINGS,
    SG,
    MixtureSettings,
    MixtureShape,
    selection_blend,
)
from engine.guiding.neural.networks.radiance import COARSE_U_ENCODINGS, Snapshot
from engine.guiding.neural.sources.network import NETWORK_KERNELS, NetworkGuide, allocate_network_guide, with_network
from engine.guiding.sources.guide_kernels import GuideKernels
from engine.kernels.bsdf import mean_roughness
from engine.kernels.bsdf.phase import phase_roughness
from engine.runtime.jit import kernel
from engine.settings import RenderSettings
from engine.spectral.wavelengths import WAVELENGTH_COUNT
from engine.state.lanes import WAVELENGTHS

#: One-blob bins for each coordinate, in place of grids whose cells see too few records
#: (docs/decisions/trees-and-neural-mixtures.md).
_COMPACT_BINS = 32
#: How u is seen, by setting: the sizes of Dong et al. 2024, sections 5 and 6.2...
_U_ENCODINGS: dict[str, dict[str, Any]] = {
    "NONE": {},
    "FREQUENCY": {"u_frequencies": 16},
    "PLANES": {"plane_levels": 8},
    "HASH4D": {"hash_levels": 8},
}
#: ... and fewer and coarser ones, beside bins, that a render on a processor can train
#: (docs/decisions/time-and-wavelengths.md).
_COMPACT_U_ENCODINGS: dict[str, dict[str, Any]] = {
    **COARSE_U_ENCODINGS,
    "HASH4D": {"hash_levels": 2, "hash_resolution": 4, "hash_growth": 2.0, "hash_size": 1 << 15},
}
_STRATA_AVERAGING = 0.9
#: Perceptrons of the preset `SMALL`, of NPM and of NASG: about a quarter of the work of a query and of a step.
_SMALL_NPM: dict[str, Any] = {"width": 32, "hidden_layers": 2}
_SMALL_NASG: dict[str, Any] = {"width": 64, "hidden_layers": 2}
#: Presets without grids.
_COMPACT_PRESETS = ("COMPACT", "SMALL")
#: Shape by source, or by what NASG is proportional to.
_NPM_SHAPES = {"NPM": NPM, "NPM_PRODUCT": NPM_PRODUCT}
_OFFICIAL_SHAPES = _NPM_SHAPES | {"NPM_PRODUCT": NPM_OFFICIAL}
_NASG_SHAPES = {"RADIANCE": NASG, "COSINE": NASG_COSINE, "PRODUCT": NASG_PRODUCT}
#: Spherical Gaussians in NASG's place have as many parameters with more lobes.
_LOBE_COUNTS = {"VMF": 8, "NASG": 8, "SG": SG.lobe_count}


def _is_npm(settings: RenderSettings) -> bool:
    return settings.source in _NPM_SHAPES


def mixture_shape(settings: RenderSettings) -> MixtureShape:
    """Shape of the network that `settings.source` names."""
    if _is_npm(settings):
        shape = (_OFFICIAL_SHAPES if settings.mixture_preset == "OFFICIAL" else _NPM_SHAPES)[settings.source]
    else:
        shape = _NASG_SHAPES[settings.mixture_target]
    is_compact = settings.mixture_preset in _COMPACT_PRESETS
    if is_compact:
        shape = replace(shape, position_encoding="BLOB", position_bins=_COMPACT_BINS)
    if settings.mixture_preset == "SMALL":
        shape = replace(shape, **(_SMALL_NPM if _is_npm(settings) else _SMALL_NASG))
    shape = replace(shape, has_selection=settings.network_selection)
    u_encoding = (_COMPACT_U_ENCODINGS if is_compact else _U_ENCODINGS)[settings.mixture_u]
    if settings.mixture_u == "HASH4D" and shape.position_encoding == "GRID":
        # An axis more, and otherwise the same grids.
        u_encoding = u_encoding | {"position_encoding": "NONE", "hash_growth": shape.growth}
    shape = replace(shape, **u_encoding)
    if settings.mixture_lobes != "OWN":
        shape = replace(
            shape, lobe_model="NASG" if settings.mixture_lobes == "NASG" else "VMF",
            lobe_count=_LOBE_COUNTS[settings.mixture_lobes],
        )
    return shape


def mixture_training(settings: RenderSettings) -> MixtureSettings:
    """How that network is trained."""
    training = NASG_SETTINGS
    if _is_npm(settings):
        training = NPM_OFFICIAL_SETTINGS if settings.mixture_preset == "OFFICIAL" else NPM_SETTINGS
    training = replace(
        training, mis_compensation=settings.mis_compensation, bsdf_share=1.0 - settings.guiding_probability
    )
    if settings.strata > 1:
        # Dong et al. 2024, section 5: the average forgets sooner.
        pieces = WAVELENGTH_COUNT if settings.u_dimension == "WAVELENGTH" else 1
        training = replace(
            training, follows_u=True, u_pieces=pieces, averaging=min(training.averaging, _STRATA_AVERAGING)
        )
    return training


def design(settings: RenderSettings) -> NetworkDesign:
    """Shape and training of the mixture; it is trained to compensate, if the settings say so."""
    shape = mixture_shape(settings)

    def make_field(snapshot: Snapshot, samples: float) -> MixtureNetwork:
        return make_mixture_network(shape, snapshot, selection_blend(samples))

    return NetworkDesign(shape, mixture_training(settings), make_field)


def make_model(settings: RenderSettings) -> NetworkSource:
    """What trains the mixture."""
    return NetworkSource(settings, design(settings))


def allocate(settings: RenderSettings, lane_count: int) -> NetworkGuide:
    """Lanes for a mixture that has learned nothing."""
    shape = mixture_shape(settings)
    sees_wavelength = settings.u_dimension == "WAVELENGTH" and shape.sees_u
    lanes = allocate_mixture_guide(shape, lane_count, WAVELENGTHS if sees_wavelength else 1)
    return allocate_network_guide(lanes, lane_count, target(settings, is_diffuse=False))


def target(settings: RenderSettings, *, is_diffuse: bool) -> str:
    """What the network is to learn; radiance times cosine comes closest to the product."""
    return "RADIANCE" if mixture_shape(settings).target == "RADIANCE" else "PRODUCT"


@kernel
def _ready_mixture(guide, lane, field, region, points, closures, is_diffuse, bits):
    """What the network will be asked with."""
    guide.fluence[lane] = field.fluence[region] if region >= 0 else np.float32(0.0)
    guide.roughness[lane] = mean_roughness(closures, lane)
    guide.is_diffuse[lane] = 1 if is_diffuse else 0
    return True



@kernel
def _ready_mixture_collision(guide, lane, field, region, points, closures, bits):
    """The same, with the roughness that records of collisions have."""
    guide.fluence[lane] = field.fluence[region] if region >= 0 else np.float32(0.0)
    guide.roughness[lane] = phase_roughness(closures, lane)
    guide.is_diffuse[lane] = 0
    return True


KERNELS = {
    NetworkGuide: NETWORK_KERNELS,
    MixtureGuide: GuideKernels(
        with_network, _ready_mixture, _ready_mixture_collision, sample_mixture, eval_mixture, predict_mixture,
        eval_mixture_wavelengths, query_mixtures, ask_for_mixture,
    ),
}
