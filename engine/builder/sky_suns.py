# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns of Sky Textures in a world: where they stand, so that each is sampled as a light of its own.

A sun is narrower than a cell of the map by which a world is sampled.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Link, World
from engine.shaders.nodes_sky import Sun, sun_of
from engine.state.lights import DISC_AXIS, DISC_ONE_MINUS_COS, DISC_WIDTH

#: Rings of a disc, and points in each, at which its radiance is looked up.
_RINGS, _SPOKES = 4, 8


@dataclass(frozen=True)
class SkySuns:
    """Suns of a world.

    Attributes
    ----------
    suns : tuple of Sun
        Those whose place is known.
    has_others : bool
        Whether it has suns that are somewhere else, for the map to find.
    """

    suns: tuple[Sun, ...] = ()
    has_others: bool = False

    def discs(self) -> Float32Array:
        """`LightArrays.discs`."""
        discs = np.zeros((len(self.suns), DISC_WIDTH), np.float32)
        for row, sun in zip(discs, self.suns, strict=True):
            row[DISC_AXIS : DISC_AXIS + 3] = sun.direction
            row[DISC_ONE_MINUS_COS] = 2.0 * np.sin(0.5 * sun.half_angle) ** 2
        return discs

    def points(self) -> np.ndarray:
        """Unit directions spread evenly over each disc, float64 (K, points, 3)."""
        radius = np.sqrt((np.repeat(np.arange(_RINGS), _SPOKES) + 0.5) / _RINGS)
        turn = 2.0 * np.pi * (np.arange(_RINGS * _SPOKES) % _SPOKES + 0.5) / _SPOKES
        result = np.empty((len(self.suns), _RINGS * _SPOKES, 3))
        for of_sun, sun in zip(result, self.suns, strict=True):
            axis = np.array(sun.direction)
            side = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
            side /= np.linalg.norm(side)
            angle = radius * sun.half_angle
            across = np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * np.cross(axis, side)
            of_sun[:] = np.cos(angle)[:, None] * axis + np.sin(angle)[:, None] * across
        return result


def find_sky_suns(world: World | None) -> SkySuns:
    """Suns of a world; Blender links no vectors to a Sky Texture that shows its sun, other hosts may."""
    if world is None or world.graph is None:
        return SkySuns()
    suns: list[Sun] = []
    has_others = False
    for node in world.graph.nodes:
        sun = sun_of(node) if node.kind == "ShaderNodeTexSky" else None
        if sun is None:
            continue
        if isinstance(node.inputs.get("Vector"), Link):
            has_others = True
        elif sun not in suns:
            suns.append(sun)
    return SkySuns(tuple(suns), has_others)
