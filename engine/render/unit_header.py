# SPDX-License-Identifier: GPL-3.0-or-later
"""What the headers of an arm's units have in common: made once an arm, since units are short in small pictures."""

from __future__ import annotations

import numpy as np

from engine.guiding.policy.guidance import Guidance
from engine.state.film import FilmLayout
from engine.state.group_parts import SPLITS_MEASURED
from engine.wavefront.columns import (
    SCENE_HAS_MEDIA,
    UNIT_ASKS_MODEL,
    UNIT_CATCHES,
    UNIT_DIVIDES_WAVELENGTHS,
    UNIT_GUIDES_MEDIA,
    UNIT_HEADER_WIDTH,
    UNIT_IS_GUIDED,
    UNIT_LEARNS_LIGHTS,
    UNIT_MEASURE_THRESHOLD,
    UNIT_PREDICTS,
    UNIT_RECORD_THRESHOLD,
    UNIT_SEED,
    UNIT_SHADER_MODE,
    UNIT_SHOWS_BACKGROUND,
    UNIT_SPLITS_LIGHT,
    UNIT_USE_DENOISING,
    UNIT_USE_FEATURES,
    UNIT_USE_OCCLUSION,
    UNIT_USES_CACHE,
)
from engine.wavefront.work import SceneView


def unit_header(
    seed: int, mode: int, view: SceneView, layout: FilmLayout, guidance: Guidance | None, *, asks_model: bool,
    learns_lights: bool, divides_wavelengths: bool,
) -> np.ndarray:
    """`UnitView.header` of an arm's units; which pixels and samples, and which stratum, is still to be said.

    Parameters
    ----------
    mode : int
        Of the interpreter, for surfaces.
    guidance : Guidance or None
        What the arm goes by.
    asks_model : bool
        Whether a model weighs candidates.
    learns_lights : bool
        Whether which lights are sampled is learned.
    divides_wavelengths : bool
        Whether strata do.

    Returns
    -------
    int64 (UNIT_HEADER_WIDTH,)
    """
    header = np.zeros(UNIT_HEADER_WIDTH, np.int64)
    header[UNIT_SEED] = seed
    header[UNIT_SHADER_MODE] = mode
    header[UNIT_USE_FEATURES] = layout.use_features
    header[UNIT_USE_DENOISING] = layout.use_denoising
    header[UNIT_SPLITS_LIGHT] = SPLITS_MEASURED if layout.measures_groups else layout.light_part_count > 0
    header[UNIT_USE_OCCLUSION] = layout.use_occlusion
    header[UNIT_SHOWS_BACKGROUND] = layout.shows_background
    header[UNIT_CATCHES] = layout.has_catchers
    header[UNIT_LEARNS_LIGHTS] = learns_lights
    header[UNIT_ASKS_MODEL] = asks_model
    header[UNIT_DIVIDES_WAVELENGTHS] = divides_wavelengths
    if guidance is not None:
        header[UNIT_RECORD_THRESHOLD] = guidance.record_threshold
        header[UNIT_IS_GUIDED] = guidance.field is not None
        header[UNIT_GUIDES_MEDIA] = view.header[SCENE_HAS_MEDIA] and guidance.guides_media
        header[UNIT_USES_CACHE] = guidance.uses_cache
        header[UNIT_PREDICTS] = guidance.roulette_field is not None
        header[UNIT_MEASURE_THRESHOLD] = guidance.measure_threshold
    return header
