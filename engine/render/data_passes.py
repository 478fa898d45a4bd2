# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of data: which a render has, where their sums are on the film, and what images these make."""

from __future__ import annotations

import re
from collections.abc import Collection

import numpy as np

from engine.scene.pass_names import MATTE_KINDS, PAIRS, aov_pass, matte_passes
from engine.scene.passes import PassSettings
from engine.shaders.aov_columns import COLOR_WIDTH, VALUE_WIDTH, aov_columns, aov_width
from engine.state.data_passes import (
    BACKWARD_MOTION_WIDTH,
    MIST_WIDTH,
    ROUGHNESS_WIDTH,
    SPECULAR_ALBEDO_WIDTH,
    SPECULAR_MOTION_WIDTH,
    SURFACE_ROUGHNESS_WIDTH,
    UV_WIDTH,
    VECTOR_WIDTH,
    DataLayout,
    DataOptions,
)

BACKWARD_MOTION = "Denoising Backward Motion"
SPECULAR_MOTION = "Denoising Specular Motion"
SPECULAR_ALBEDO = "Denoising Specular Albedo"
ROUGHNESS = "Denoising Roughness"
SURFACE_ROUGHNESS = "Roughness"
DATA_PASSES = ("Mist", "UV", "Vector", BACKWARD_MOTION, SPECULAR_MOTION, SPECULAR_ALBEDO, ROUGHNESS, SURFACE_ROUGHNESS)
_MATTE_NAME = re.compile(f"({'|'.join(MATTE_KINDS)})([0-9]{{2}})")


def matte_kind(name: str) -> str:
    """Kind of Cryptomatte that a pass belongs to, '' for others."""
    match = _MATTE_NAME.fullmatch(name)
    return match[1] if match else ""


def data_images(
    layout: DataLayout, data: np.ndarray, mattes: np.ndarray, scale: np.ndarray, shape: tuple[int, int],
    names: Collection[str],
) -> dict[str, np.ndarray]:
    """Images by pass name.

    Parameters
    ----------
    data : float32 (P, D); mattes : float32 (P, M, 2)
        Sums over samples.
    scale : float32 (P, 1)
        One over their weights, 0 where there is none.
    shape : (int, int)
        Height and width of the image.
    names : collection of str
        What is asked for; other names are left to others.

    Returns
    -------
    dict of float32 (height, width, channels)
        Mist from 0 to 1; UV and whether there is any; Vector [pixels] to the frame before and from the frame after,
        mean of the samples that have one; Denoising Backward Motion [pixels, pixels, m], Denoising Specular Motion
        [pixels, pixels, 0], Denoising Specular Albedo and Denoising Roughness, mean of all samples; colours of AOVs
        with the share of samples that have one as alpha.
    """
    images: dict[str, np.ndarray] = {}
    options = layout.options
    has_samples = scale > 0.0
    if options.mist >= 0 and "Mist" in names:
        clear = data[:, options.mist : options.mist + MIST_WIDTH] * scale
        images["Mist"] = np.where(has_samples, 1.0 - clear, np.float32(0.0))
    if options.uv >= 0 and "UV" in names:
        images["UV"] = data[:, options.uv : options.uv + UV_WIDTH] * scale
    if options.vector >= 0 and "Vector" in names:
        sums = data[:, options.vector : options.vector + VECTOR_WIDTH]
        images["Vector"] = sums[:, :-1] / np.maximum(sums[:, -1:], np.float32(1e-30))
    if options.backward_motion >= 0 and BACKWARD_MOTION in names:
        first = options.backward_motion
        images[BACKWARD_MOTION] = data[:, first : first + BACKWARD_MOTION_WIDTH] * scale
    if options.specular_motion >= 0 and SPECULAR_MOTION in names:
        first = options.specular_motion
        # Blender's pass has three channels, of which Cycles fills two.
        images[SPECULAR_MOTION] = np.pad(data[:, first : first + SPECULAR_MOTION_WIDTH] * scale, ((0, 0), (0, 1)))
    for name, first, width in (
        (SPECULAR_ALBEDO, options.specular_albedo, SPECULAR_ALBEDO_WIDTH),
        (ROUGHNESS, options.roughness, ROUGHNESS_WIDTH),
        (SURFACE_ROUGHNESS, options.surface_roughness, SURFACE_ROUGHNESS_WIDTH),
    ):
        if first >= 0 and name in names:
            images[name] = data[:, first : first + width] * scale
    for name, first, width in layout.aovs:
        if name in names:
            images[name] = data[:, first : first + width] * scale
    for kind, first in layout.mattes:
        asked = [name in names for name in matte_passes(kind, options.matte_slots)]
        if not any(asked):
            continue
        slots = mattes[:, first : first + options.matte_slots]
        order = np.argsort(-slots[..., 1], axis=1, kind="stable")
        slots = np.take_along_axis(slots, order[..., None], axis=1)
        slots[..., 1] *= scale
        for index, name in enumerate(matte_passes(kind, options.matte_slots)):
            if asked[index]:
                images[name] = slots[:, PAIRS * index : PAIRS * (index + 1)].reshape(-1, 2 * PAIRS)
    return {
        name: np.ascontiguousarray(image, np.float32).reshape(*shape, image.shape[1])
        for name, image in images.items()
    }


def data_layout(names: Collection[str], settings: PassSettings) -> DataLayout:
    """Columns and slots for those passes of data that are among `names`.

    AOVs get columns all together or not at all: programs are compiled for all of them.
    """
    threshold = np.float32(settings.alpha_threshold)
    width = matte_count = 0
    columns: dict[str, int] = {}

    def place(name: str, count: int, is_asked: bool) -> None:
        nonlocal width
        if is_asked and count:
            columns[name] = width
            width += count

    place("mist", MIST_WIDTH, "Mist" in names)
    place("uv", UV_WIDTH, "UV" in names)
    place("vector", VECTOR_WIDTH, "Vector" in names)
    place("backward_motion", BACKWARD_MOTION_WIDTH, BACKWARD_MOTION in names)
    place("specular_motion", SPECULAR_MOTION_WIDTH, SPECULAR_MOTION in names)
    place("specular_albedo", SPECULAR_ALBEDO_WIDTH, SPECULAR_ALBEDO in names)
    place("roughness", ROUGHNESS_WIDTH, ROUGHNESS in names)
    place("surface_roughness", SURFACE_ROUGHNESS_WIDTH, SURFACE_ROUGHNESS in names)
    place("aov", aov_width(settings.aovs), True)
    passes_by_kind: dict[str, int] = {}
    for name in names:
        if match := _MATTE_NAME.fullmatch(name):
            kind, index = match.groups()
            passes_by_kind[kind] = max(passes_by_kind.get(kind, 0), int(index) + 1)
    slots = PAIRS * max(passes_by_kind.values(), default=0)
    mattes: dict[str, int] = {}
    for kind in MATTE_KINDS:
        if kind in passes_by_kind:
            mattes[kind] = matte_count
            matte_count += slots
    options = DataOptions(
        is_used=int(bool(width or matte_count)),
        **columns,
        asks_for_mirrors=int(bool(columns.keys() & {"specular_motion", "specular_albedo", "roughness"})),
        aov_width=aov_width(settings.aovs),
        object_mattes=mattes.get("CryptoObject", -1),
        material_mattes=mattes.get("CryptoMaterial", -1),
        asset_mattes=mattes.get("CryptoAsset", -1),
        matte_slots=slots,
        mist_start=np.float32(settings.mist_start),
        mist_inverse_depth=np.float32(1.0 / settings.mist_depth if settings.mist_depth > 0.0 else 0.0),
        mist_falloff=np.float32(settings.mist_falloff),
        alpha_threshold=threshold,
        background_moves=int(settings.background_moves),
        looks_up_transmission=int(settings.looks_up_transmission),
        follows_mirrors=int(settings.follows_mirrors),
        weighs_by_roughness=int(settings.weighs_by_roughness),
    )
    aovs = tuple(
        (aov_pass(aov.name), options.aov + aov.column, COLOR_WIDTH if aov.is_color else VALUE_WIDTH)
        for aov in aov_columns(settings.aovs)
    )
    return DataLayout(options, width, matte_count, aovs, tuple(mattes.items()))
