# SPDX-License-Identifier: GPL-3.0-or-later
"""Passes of light taken apart: by the lobes that sent it to the camera, and by light group.

As in Cycles, the passes of light are divided by the pass of colour of their lobes, so that

    Combined = Emission + Environment + sum over lobes of Color x (Direct + Indirect)
        + Volume Direct + Volume Indirect.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import numpy as np

from engine.state.film import LIGHT_DIFFUSE_COLOR, LIGHT_OCCLUSION, LIGHT_PARTS, FilmLayout
from engine.state.group_parts import measured_part_count
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
_INDIRECT_PASSES = frozenset((*(f"{lobes} Indirect" for lobes in _LOBES), "Volume Indirect"))
_GROUP_PREFIX = "Combined_"


def group_pass(group: str) -> str:
    """Name of a light group's pass, Cycles' own."""
    return _GROUP_PREFIX + group


def asks_for_groups(names: Iterable[str], groups: Sequence[str]) -> bool:
    """Whether a light group's pass is among these names."""
    return not {*map(group_pass, groups)}.isdisjoint(names)


def light_part_count(
    names: Iterable[str], groups: Sequence[str], *, has_media: bool = False, measures_groups: bool = False
) -> int:
    """Parts that light must be taken apart into for these passes, in a scene of these groups, with or without media; 0:
    no pass needs any.
    """
    needed = {*LIGHT_PASSES, *map(group_pass, groups)}
    count = PART_GROUPS + len(groups)
    if measures_groups:
        count += measured_part_count(len(groups))
    if has_media or measures_groups:
        count += VOLUME_PARTS
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
    names: frozenset[str] | set[str], layout: FilmLayout, light: np.ndarray, scale: np.ndarray,
    residual: np.ndarray | None, exposure: float, behind: np.ndarray | None = None,
) -> dict[str, np.ndarray]:
    """Passes by name.

    Parameters
    ----------
    names : set of str
        What is asked for, of LIGHT_PASSES and passes of groups; other names are left to others.
    layout : FilmLayout
    light : float32 (P, `layout.light_width`)
        Sums over samples.
    scale : float32 (P, 1)
        What makes means of them.
    residual : float32 (P, 3), optional
        What the radiance cache is known to lack. It is indirect light, and is shared out as the other indirect light
        of its pixel.
    exposure : float
    behind : float32 (G + 1, P, 3), optional
        Light of each group that its part lacks (`engine.render.group_residual`).

    Returns
    -------
    dict of float32 (P, 3)
    """
    groups, has_media = layout.light_groups, layout.has_media

    def column(first: int) -> np.ndarray:
        means: np.ndarray = light[:, first : first + RGB] * scale
        return means

    def part(index: int) -> np.ndarray:
        return column(LIGHT_PARTS + RGB * index)

    of_volume = layout.light_part_count - VOLUME_PARTS
    shares: tuple[np.ndarray, np.ndarray] | None = None
    if residual is not None and not names.isdisjoint(_INDIRECT_PASSES):
        total = sum(part(first + 1) for first in (*_LOBES.values(), *([of_volume] if has_media else [])))
        has_light = total != 0.0
        # Where nothing tells whose it is, diffuse lobes have it: they send paths into the cache.
        rest = np.where(has_light, np.float32(0.0), residual)
        factor = np.where(has_light, residual / np.where(has_light, total, np.float32(1.0)), np.float32(0.0))
        shares = factor, rest

    def indirect(first: int) -> np.ndarray:
        values = part(first + 1)
        if shares is None:
            return values
        factor, rest = shares
        values = values + values * factor
        return values + rest if first == PART_DIFFUSE else values

    images: dict[str, np.ndarray] = {}
    if OCCLUSION_PASS in names:
        images[OCCLUSION_PASS] = column(LIGHT_OCCLUSION)
    for index, (lobes, first) in enumerate(_LOBES.items()):
        if names.isdisjoint((f"{lobes} Color", f"{lobes} Direct", f"{lobes} Indirect")):
            continue
        color = column(LIGHT_DIFFUSE_COLOR + RGB * index)
        images[f"{lobes} Color"] = color
        if f"{lobes} Direct" in names:
            images[f"{lobes} Direct"] = divide_by_color(part(first) * np.float32(exposure), color)
        if f"{lobes} Indirect" in names:
            images[f"{lobes} Indirect"] = divide_by_color(indirect(first) * np.float32(exposure), color)
    for name in names.intersection(_VOLUME_PASSES):
        images[name] = np.zeros_like(part(0))
        if has_media:
            light_of = part(of_volume) if name == "Volume Direct" else indirect(of_volume)
            images[name] = light_of * np.float32(exposure)
    for index, group in enumerate(groups):
        if group_pass(group) in names:
            mean = part(PART_GROUPS + index)
            images[group_pass(group)] = (mean if behind is None else mean + behind[index]) * np.float32(exposure)
    return {name: image for name, image in images.items() if name in names}
