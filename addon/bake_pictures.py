# SPDX-License-Identifier: GPL-3.0-or-later
"""What Blender's bake types are: the passes of a render that each is made of, and how."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

Pixels = npt.NDArray[np.float32]

# Bits of Blender's filter of passes; a bake type without contributions has all of them.
FILTER_EMIT = 1 << 1
FILTER_DIFFUSE = 1 << 2
FILTER_GLOSSY = 1 << 3
FILTER_TRANSMISSION = 1 << 4
FILTER_DIRECT = 1 << 6
FILTER_INDIRECT = 1 << 7
FILTER_COLOR = 1 << 8

#: Lobes by Blender's bake types, and their bit among what makes up the combined picture.
_LOBES = {
    "DIFFUSE": ("Diffuse", FILTER_DIFFUSE),
    "GLOSSY": ("Glossy", FILTER_GLOSSY),
    "TRANSMISSION": ("Transmission", FILTER_TRANSMISSION),
}
#: Bake types that are a pass each, and nothing of which depends on light from elsewhere.
_DATA = {
    "NORMAL": "Normal",
    "UV": "UV",
    "POSITION": "Position",
    "ROUGHNESS": "Roughness",
    "EMIT": "Emission",
    "ENVIRONMENT": "Environment",
}
#: Bits without which a combined bake is no sum of some of its passes, but the picture itself.
_WHOLE = FILTER_EMIT | FILTER_DIFFUSE | FILTER_GLOSSY | FILTER_TRANSMISSION | FILTER_DIRECT | FILTER_INDIRECT


#: `BakePicture.outside` of light, and of shadows.
_CLEAR = (0.0, 0.0, 0.0, 0.0)
_UNSHADOWED = (1.0, 1.0, 1.0, 1.0)


@dataclass(frozen=True)
class BakePicture:
    """What a bake is made of.

    passes : frozenset of str
        The engine's names of the passes that it needs.
    mix : callable
        Makes the pixels, float32 (H, W, 3 or 4), of these passes by name.
    outside : tuple of 4 floats
        Pixels that look at no place, as in Cycles; others are opaque where `mix` makes no alpha.
    is_lit : bool
        Whether light has to be followed for it.
    is_of_background : bool
        Whether places only say where to look for the background.
    catches_shadows : bool
        Whether the object is baked as a shadow catcher.
    """

    passes: frozenset[str]
    mix: Callable[[Mapping[str, Pixels]], Pixels]
    outside: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 1.0)
    is_lit: bool = True
    is_of_background: bool = False
    catches_shadows: bool = False

    def compose(self, images: Mapping[str, Pixels]) -> Pixels:
        """Pixels with alpha, float32 (H, W, 4): what the passes have of it, or 1."""
        pixels = self.mix(images)
        whole = np.ones((*pixels.shape[:2], 4), np.float32)
        # A single channel is grey.
        whole[..., : max(pixels.shape[2], 3)] = pixels
        return whole

    def background(self, height: int, width: int) -> Pixels:
        """Pixels that look at no place, float32 (H, W, 4)."""
        return np.tile(np.array(self.outside, np.float32), (height, width, 1))


def bake_picture(pass_type: str, pass_filter: int) -> BakePicture:
    """What a bake of Blender's type is made of.

    Parameters
    ----------
    pass_type : str
        As `RenderEngine.bake` gets it.
    pass_filter : int
        FILTER_* bits.

    Raises
    ------
    ValueError
        If there is no such bake here.
    """
    if pass_type in _DATA:
        name = _DATA[pass_type]
        return BakePicture(
            frozenset((name,)), lambda images: images[name], is_lit=False,
            is_of_background=pass_type == "ENVIRONMENT",
        )  # fmt: skip
    if pass_type in _LOBES:
        name, _bit = _LOBES[pass_type]
        names = _lobe_passes(name, pass_filter)
        return BakePicture(
            names, lambda images: _lobe_light(name, names, images), _CLEAR, is_lit=names != {f"{name} Color"}
        )  # fmt: skip
    if pass_type == "COMBINED":
        return _combined(pass_filter)
    if pass_type == "AO":
        return BakePicture(frozenset(("Ambient Occlusion",)), lambda images: images["Ambient Occlusion"], is_lit=False)
    if pass_type == "SHADOW":
        return BakePicture(
            frozenset(("Shadow Catcher",)), lambda images: images["Shadow Catcher"][..., :3], _UNSHADOWED,
            catches_shadows=True,
        )
    raise ValueError(
        f"NeuralGuide cannot bake {pass_type}: choose one of "
        f"{', '.join(sorted((*_DATA, *_LOBES, 'COMBINED', 'AO', 'SHADOW')))}, or bake it by Cycles"
    )


def _lobe_passes(name: str, pass_filter: int) -> frozenset[str]:
    """Passes that the light of some lobes is made of; their colour alone where no light is asked for."""
    found = set()
    if pass_filter & FILTER_DIRECT:
        found.add(f"{name} Direct")
    if pass_filter & FILTER_INDIRECT:
        found.add(f"{name} Indirect")
    if pass_filter & FILTER_COLOR or not found:
        found.add(f"{name} Color")
    return frozenset(found)


def _lobe_light(name: str, names: frozenset[str], images: Mapping[str, Pixels]) -> Pixels:
    """Light of some lobes, times their colour, as far as these passes are among `names`."""
    light = [images[one][..., :3] for one in (f"{name} Direct", f"{name} Indirect") if one in names]
    color = images[f"{name} Color"][..., :3] if f"{name} Color" in names else None
    if not light:
        assert color is not None
        return color
    total: Pixels = np.sum(light, axis=0)
    return total if color is None else total * color


def _combined(pass_filter: int) -> BakePicture:
    """The picture, or the sum of what is asked of it; each with its colour, as in Cycles."""
    if pass_filter & _WHOLE == _WHOLE:
        return BakePicture(frozenset(("Combined",)), lambda images: images["Combined"], _CLEAR)
    is_lit = bool(pass_filter & (FILTER_DIRECT | FILTER_INDIRECT))
    lobes = {
        name: _lobe_passes(name, pass_filter | FILTER_COLOR)
        for name, bit in _LOBES.values()
        if is_lit and pass_filter & bit
    }
    emits = bool(pass_filter & FILTER_EMIT)
    names = frozenset().union(*lobes.values(), ("Combined",), ("Emission",) if emits else ())

    def mix(images: Mapping[str, Pixels]) -> Pixels:
        total = np.zeros_like(images["Combined"])
        total[..., 3] = images["Combined"][..., 3]
        if emits:
            total[..., :3] += images["Emission"][..., :3]
        for name, needed in lobes.items():
            total[..., :3] += _lobe_light(name, needed, images)
        return total

    return BakePicture(names, mix, _CLEAR, is_lit=bool(lobes))
