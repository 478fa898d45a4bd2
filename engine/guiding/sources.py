# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks that directions are drawn from: their shape and training, as the settings ask for them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from engine.guiding.flow.shape import FlowSettings, FlowShape
from engine.guiding.mixture.shape import (
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
)
from engine.guiding.network import COARSE_U_ENCODINGS
from engine.settings import RenderSettings
from engine.spectral.wavelengths import WAVELENGTH_COUNT

#: One-blob bins for each coordinate, in place of grids whose cells see too few records (docs/experiments.md).
_COMPACT_BINS = 32
#: How u is seen, by setting: the sizes of Dong et al. 2025, sections 5 and 6.2...
_U_ENCODINGS: dict[str, dict[str, Any]] = {
    "NONE": {},
    "FREQUENCY": {"u_frequencies": 16},
    "PLANES": {"plane_levels": 8},
    "HASH4D": {"hash_levels": 8},
}
#: ... and fewer and coarser ones, beside bins, that a render on a processor can train (docs/benchmarks.md).
_COMPACT_U_ENCODINGS: dict[str, dict[str, Any]] = {
    **COARSE_U_ENCODINGS,
    "HASH4D": {"hash_levels": 2, "hash_resolution": 4, "hash_growth": 2.0, "hash_size": 1 << 15},
}
_STRATA_AVERAGING = 0.9
_NASG_SHAPES = {"RADIANCE": NASG, "COSINE": NASG_COSINE, "PRODUCT": NASG_PRODUCT}
#: Spherical Gaussians in NASG's place have as many parameters with more lobes.
_LOBE_COUNTS = {"VMF": 8, "NASG": 8, "SG": SG.lobe_count}


def source_shape(settings: RenderSettings) -> MixtureShape | FlowShape:
    """Shape of the network that `settings.source` names.

    Raises
    ------
    ValueError
        If it names none.
    """
    if settings.source == "FLOW":
        return FlowShape()
    if settings.source == "NASG":
        shape = _NASG_SHAPES[settings.mixture_target]
    elif settings.source in ("NPM", "NPM_PRODUCT"):
        product = NPM_OFFICIAL if settings.mixture_preset == "OFFICIAL" else NPM_PRODUCT
        shape = product if settings.source == "NPM_PRODUCT" else NPM
    else:
        raise ValueError(f"source {settings.source!r} is no network")
    if settings.mixture_preset == "COMPACT":
        shape = replace(shape, position_encoding="BLOB", position_bins=_COMPACT_BINS)
    shape = replace(shape, has_selection=settings.network_selection)
    is_compact = settings.mixture_preset == "COMPACT"
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


def source_training(settings: RenderSettings) -> MixtureSettings | FlowSettings:
    """How that network is trained."""
    shape = source_shape(settings)
    if isinstance(shape, FlowShape):
        return FlowSettings()
    training = NASG_SETTINGS if settings.source == "NASG" else NPM_SETTINGS
    if settings.mixture_preset == "OFFICIAL" and settings.source != "NASG":
        training = NPM_OFFICIAL_SETTINGS
    training = replace(
        training, mis_compensation=settings.mis_compensation, bsdf_share=1.0 - settings.guiding_probability
    )
    if settings.strata > 1:
        # Dong et al. 2025, section 5: the average forgets sooner.
        pieces = WAVELENGTH_COUNT if settings.u_dimension == "WAVELENGTH" else 1
        training = replace(
            training, follows_u=True, u_pieces=pieces, averaging=min(training.averaging, _STRATA_AVERAGING)
        )
    return training
