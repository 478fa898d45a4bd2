# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of light taken apart: by the lobes that sent it to the camera, and by light group.

As in Cycles, the passes of light are divided by the pass of colour of their lobes, so that

    Combined = Emission + Environment + sum over lobes of Color x (Direct + Indirect)
        + Volume Direct + Volume Indirect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from engine.state.film import LIGHT_DIFFUSE_COLOR, LIGHT_OCCLUSION, LIGHT_PARTS
from engine.state.lanes import PART_DIFFUSE, PART_GLOSSY, PART_GROUPS, PART_TRANSMISSION, RGB, VOLUME_PARTS

#: First part of each kind of lobes, in the order of the columns of colours.
_LOBES = {"Diffuse": PART_DIFFUSE, "Glossy": PART_GLOSSY, "Transmission": PART_TRANSMISSION}
#: Not divided by a colour. Black in scenes without media, for node trees that add up all passes.
_VOLUME_PASSES = ("Volume Direct", "Volume Indirect")
OCCLUSION_PASS = "Ambient Occlusion"
LIGHT_PASSES = (
    *(f"{lobes} {light}" for lobes in _LOBES for light in ("Direct", "Indirect", "Color")),
    *_VOLUME_PASSES,
    OCCLUSION_PASS,
)
_GROUP_PREFIX = "Combined_"


def group_pass(group: str) -> str:
    """Name of a light group's pass, Cycles' own."""
    return _GROUP_PREFIX + group


def light_part_count(names: Iterable[str], groups: Sequence[str], *, has_media: bool = False) -> int:
    """Parts that light must be taken apart into for these passes, in a scene of these groups, with or without media; 0:
    no pass needs any.
    """
    needed = {*LIGHT_PASSES, *map(group_pass, groups)}
    count = PART_GROUPS + len(groups) + (VOLUME_PARTS if has_media else 0)
    return count if needed.intersection(names) else 0


def divide_by_color(light: np.ndarray, color: np.ndarray) -> np.ndarray:
    """Light over colour; a channel that the colour lacks gets the mean of the others', so that white light stays white.

    Parameters
    ----------
    light, color : float32 (P, 3)

    Returns
    -------
    float32 (P, 3)
        0 where there is no colour.
    """
    has_color = color != 0.0
    divided = np.where(has_color, light / np.where(has_color, color, np.float32(1.0)), np.float32(0.0))
    mean = divided.sum(axis=-1, keepdims=True) / np.maximum(has_color.sum(axis=-1, keepdims=True), 1)
    return np.where(has_color, divided, mean).astype(np.float32)


def light_images(
    names: frozenset[str] | set[str], groups: Sequence[str], light: np.ndarray, residual: np.ndarray | None,
    exposure: float,
) -> dict[str, np.ndarray]:
    """Passes by name.

    Parameters
    ----------
    names : set of str
        What is asked for, of LIGHT_PASSES and passes of groups; other names are left to others.
    groups : sequence of str
    light : float32 (P, LIGHT_PARTS + 3 * parts)
        Means over samples.
    residual : float32 (P, 3), optional
        What the radiance cache is known to lack. It is indirect light, and is shared out as the other indirect light
        of its pixel.
    exposure : float

    Returns
    -------
    dict of float32 (P, 3)
    """

    def part(index: int) -> np.ndarray:
        column = LIGHT_PARTS + RGB * index
        return light[:, column : column + RGB]

    indirect = {lobes: part(first + 1) for lobes, first in _LOBES.items()}
    if residual is not None:
        total = sum(indirect.values())
        has_light = total != 0.0
        # Where nothing tells whose it is, diffuse lobes have it: they send paths into the cache.
        rest = np.where(has_light, np.float32(0.0), residual)
        factor = np.where(has_light, residual / np.where(has_light, total, np.float32(1.0)), np.float32(0.0))
        indirect = {lobes: values + values * factor for lobes, values in indirect.items()}
        indirect["Diffuse"] = indirect["Diffuse"] + rest
    images: dict[str, np.ndarray] = {OCCLUSION_PASS: light[:, LIGHT_OCCLUSION : LIGHT_OCCLUSION + RGB]}
    for index, (lobes, first) in enumerate(_LOBES.items()):
        column = LIGHT_DIFFUSE_COLOR + RGB * index
        color = light[:, column : column + RGB]
        images[f"{lobes} Color"] = color
        for kind, values in (("Direct", part(first)), ("Indirect", indirect[lobes])):
            if f"{lobes} {kind}" in names:
                images[f"{lobes} {kind}"] = divide_by_color(values * np.float32(exposure), color)
    first = PART_GROUPS + len(groups)
    has_media = light.shape[1] > LIGHT_PARTS + RGB * first
    for index, name in enumerate(_VOLUME_PASSES):
        images[name] = part(first + index) * np.float32(exposure) if has_media else np.zeros_like(part(0))
    images |= {
        group_pass(group): part(PART_GROUPS + index) * np.float32(exposure) for index, group in enumerate(groups)
    }
    return {name: image for name, image in images.items() if name in names}
