# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's colour spaces as transfer functions and matrices (those that are no more than that)."""

from __future__ import annotations

from collections.abc import Callable

import mathutils
import numpy as np

from engine.array_types import Float32Array

# Primaries and white as CIE xy: red, green, blue, white.
_D65 = (0.3127, 0.3290)
_D60 = (0.32168, 0.33767)
_E = (1.0 / 3.0, 1.0 / 3.0)
_PRIMARIES = {
    "Rec.709": ((0.64, 0.33), (0.30, 0.60), (0.15, 0.06), _D65),
    "Rec.2020": ((0.708, 0.292), (0.170, 0.797), (0.131, 0.046), _D65),
    "P3": ((0.680, 0.320), (0.265, 0.690), (0.150, 0.060), _D65),
    "AP0": ((0.7347, 0.2653), (0.0, 1.0), (0.0001, -0.0770), _D60),
    "AP1": ((0.713, 0.293), (0.165, 0.830), (0.128, 0.044), _D60),
    "E-Gamut": ((0.800, 0.3177), (0.180, 0.900), (0.065, -0.0805), _D65),
}

_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])


def _white(xy: tuple[float, float]) -> np.ndarray:
    return np.array([xy[0] / xy[1], 1.0, (1.0 - xy[0] - xy[1]) / xy[1]])


def _adapt(source: tuple[float, float], target: tuple[float, float]) -> np.ndarray:
    """Bradford's adaptation of XYZ from one white to another."""
    scale = (_BRADFORD @ _white(target)) / (_BRADFORD @ _white(source))
    return np.linalg.inv(_BRADFORD) @ np.diag(scale) @ _BRADFORD


def _to_xyz(name: str) -> np.ndarray:
    """Linear RGB of the primaries to XYZ under D65."""
    if name == "XYZ D65":
        return np.eye(3)
    if name == "XYZ E":
        return _adapt(_E, _D65)
    red, green, blue, white = _PRIMARIES[name]
    columns = np.stack([_white(xy) for xy in (red, green, blue)], axis=1)
    matrix = columns * np.linalg.solve(columns, _white(white))
    return _adapt(white, _D65) @ matrix


def _identity(values: Float32Array) -> Float32Array:
    return values


def from_srgb(values: Float32Array) -> Float32Array:
    """IEC 61966-2-1, Eq. (5) to (6)."""
    return np.where(values <= 0.04045, values / 12.92, ((np.maximum(values, 0.0) + 0.055) / 1.055) ** 2.4)


def _from_rec1886(values: Float32Array) -> Float32Array:
    """ITU-R BT.1886 with a black of zero."""
    return np.maximum(values, np.float32(0.0)) ** np.float32(2.4)


_SPACES: dict[str, tuple[Callable[[Float32Array], Float32Array], str]] = {
    "sRGB": (from_srgb, "Rec.709"),
    "Display P3": (from_srgb, "P3"),
    "Rec.1886": (_from_rec1886, "Rec.709"),
    "Rec.2020": (_from_rec1886, "Rec.2020"),
    "Linear Rec.709": (_identity, "Rec.709"),
    "Linear": (_identity, "Rec.709"),
    "Linear Rec.2020": (_identity, "Rec.2020"),
    "Linear DCI-P3 D65": (_identity, "P3"),
    "Linear CIE-XYZ D65": (_identity, "XYZ D65"),
    "Linear CIE-XYZ E": (_identity, "XYZ E"),
    "XYZ": (_identity, "XYZ D65"),
    "ACES2065-1": (_identity, "AP0"),
    "Linear ACES": (_identity, "AP0"),
    "ACEScg": (_identity, "AP1"),
    "Linear ACEScg": (_identity, "AP1"),
    "Linear FilmLight E-Gamut": (_identity, "E-Gamut"),
}

def to_srgb(pixels: Float32Array, *, is_associated: bool) -> Float32Array:
    """Scene-linear colours of Rec.709 as sRGB stores them; alpha untouched, and multiplied to colours as before."""
    result = pixels.copy()
    colors, alpha = result[..., :3], result[..., 3:]
    factor = np.where(alpha > 0.0, alpha, np.float32(1.0)) if is_associated else np.float32(1.0)
    colors /= factor
    curve = np.float32(1.055) * np.maximum(colors, np.float32(0.0031308)) ** np.float32(1.0 / 2.4) - np.float32(0.055)
    result[..., :3] = np.where(colors <= np.float32(0.0031308), colors * np.float32(12.92), curve) * factor
    return result


#: Names for data that is no colour.
DATA_SPACES = ("Non-Color", "Raw", "Generic Data", "Utility - Raw")

#: Working spaces of Blender 5.0 by its own names: the engine's name, and the primaries.
_WORKING_SPACES = {
    "Linear Rec.709": ("Rec.709", "Rec.709"),
    "Linear Rec.2020": ("Rec.2020", "Rec.2020"),
    "ACEScg": ("ACEScg", "AP1"),
}


def working_space(name: str) -> tuple[str, Float32Array | None] | None:
    """The engine's name of Blender's working space and its matrix to XYZ; None if the space is not known."""
    if name not in _WORKING_SPACES:
        return None
    own_name, primaries = _WORKING_SPACES[name]
    matrix = None if primaries == "Rec.709" else _to_xyz(primaries).astype(np.float32)
    return own_name, matrix


def blender_to_xyz() -> Float32Array:
    """Blender's scene-linear colours to XYZ under D65, by its configuration of OpenColorIO, float32 (3, 3)."""
    columns = [mathutils.Color(axis).from_scene_linear_to_xyz_d65() for axis in np.eye(3).tolist()]
    return np.array(columns, np.float32).T


def to_scene_linear(pixels: Float32Array, space: str, working: str) -> Float32Array | None:
    """Colours stored in `space` as scene-linear, alpha untouched; None if the space is not known.

    Parameters
    ----------
    pixels : float32 (height, width, 4)
    space : str
        Blender's name of a colour space.
    working : str
        'Rec.709', 'Rec.2020', 'ACEScg', or the name that a configuration of OpenColorIO has for another space.
    """
    target = "AP1" if working == "ACEScg" else working
    if space == "scene_linear":
        return pixels
    if space not in _SPACES or target not in _PRIMARIES:
        return None
    decode, primaries = _SPACES[space]
    result = np.empty_like(pixels)
    colors = decode(pixels[..., :3])
    if primaries != target:
        matrix = np.linalg.solve(_to_xyz(target), _to_xyz(primaries)).astype(np.float32)
        colors = colors @ matrix.T
    result[..., :3] = colors
    result[..., 3] = pixels[..., 3]
    return result
