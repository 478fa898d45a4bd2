# SPDX-License-Identifier: GPL-3.0-or-later
"""Sky Texture as kernels look it up: the texels of its map, the disc of its sun, formulas; and broken settings."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.shader import sky as kernels
from engine.scene.description import Link, Node, NodeGraph, Notice
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.nodes_sky import sun_of
from engine.sky.multiple_scattering import sky_map, sun_ends
from engine.sky.sky_maps import MAP_WIDTH, Atmosphere, row_elevations
from engine.spectral.observer import XYZ_TO_REC709

ATMOSPHERE = Atmosphere(0.5, 100.0, 1.0, 1.0, 1.0)
SETTINGS = {"sun_elevation": 0.5, "sun_rotation": 1.0, "sun_size": 0.05, "sun_intensity": 2.0}


def sky_table(size: int, **properties: object) -> tuple[np.ndarray, list[Notice]]:
    """The table of a sky, which has so many floats and is the last of its program's, and what is reported."""
    sky = Node("ShaderNodeTexSky", "Sky", {}, {"sky_type": "MULTIPLE_SCATTERING", **properties})
    background = Node("ShaderNodeBackground", "Background", {"Color": Link(0, "Color"), "Strength": 1.0})
    graph = NodeGraph([sky, background], surface=Link(1, "Background"))
    arrays, _, notices = compile_programs([ProgramSource("W", graph, kind="WORLD")], [])
    return np.ascontiguousarray(arrays.tables[-size:]), notices


def colors(table: np.ndarray, kind: int, directions: np.ndarray) -> np.ndarray:
    """Of directions, (N, 3): float64 (N, 3)."""
    return np.array([kernels.sky_color(table, 0, kind, tuple(d)) for d in directions.astype(np.float32)])


_MAP_SIZE = kernels.MAP_TEXELS + 3 * kernels.MAP_WIDTH * kernels.MAP_HEIGHT


def test_texels_are_found_where_the_map_has_them() -> None:
    table, notices = sky_table(_MAP_SIZE, **SETTINGS, sun_disc=False)
    assert notices == []
    texels = np.maximum(sky_map(ATMOSPHERE) @ XYZ_TO_REC709.T, 0.0)
    rows, columns = np.array([3, 100, 128, 150, 200, 250]), np.array([5, 100, 255, 256, 400, 511])
    elevation = row_elevations()[rows]
    # The sun is in the middle of the columns, which go on towards the right of who looks at it.
    azimuth = 2.0 * math.pi * (columns + 0.5 - 0.5 * MAP_WIDTH) / MAP_WIDTH + SETTINGS["sun_rotation"]
    across = np.cos(elevation)
    directions = np.stack([across * np.sin(azimuth), across * np.cos(azimuth), np.sin(elevation)], axis=1)
    found = colors(table, kernels.SKY_MAP, directions)
    np.testing.assert_allclose(found, texels[rows, columns], rtol=2e-3)


def test_the_disc_has_the_suns_irradiance_less_its_limb() -> None:
    table, _ = sky_table(_MAP_SIZE, **SETTINGS)
    sun = sun_of(Node("ShaderNodeTexSky", "Sky", {}, SETTINGS))
    assert sun is not None
    without, _ = sky_table(_MAP_SIZE, **SETTINGS, sun_disc=False)
    axis = np.array(sun.direction)
    ends = 2.0 * sun_ends(ATMOSPHERE, 0.05) @ XYZ_TO_REC709.T
    middle = colors(table, kernels.SKY_MAP, axis[None]) - colors(without, kernels.SKY_MAP, axis[None])
    np.testing.assert_allclose(middle[0], ends.mean(axis=0), rtol=1e-3)
    side = np.cross(axis, (0.0, 0.0, 1.0))
    side /= np.linalg.norm(side)
    for share, limb in ((0.5, 1.0 - 0.6 * (1.0 - math.sqrt(0.75))), (0.99, 1.0 - 0.6 * (1.0 - math.sqrt(0.0199)))):
        d = math.cos(share * 0.025) * axis + math.sin(share * 0.025) * side
        found = colors(table, kernels.SKY_MAP, d[None])[0]
        np.testing.assert_allclose(found, limb * ends.mean(axis=0), rtol=0.02)
    beyond = math.cos(0.0251) * axis + math.sin(0.0251) * side
    np.testing.assert_array_equal(
        colors(table, kernels.SKY_MAP, beyond[None]), colors(without, kernels.SKY_MAP, beyond[None])
    )


@pytest.mark.parametrize(("kind", "code"), [
    ("PREETHAM", kernels.SKY_CHROMATIC_DAYLIGHT), ("HOSEK_WILKIE", kernels.SKY_DAYLIGHT),
])  # fmt: skip
def test_formulas_are_blue_and_finite_all_around(kind: str, code: int) -> None:
    settings = {"sky_type": kind, "sun_direction": (0.0, 0.6, 0.8), "turbidity": 2.2, "ground_albedo": 0.3}
    table, notices = sky_table(kernels.DAYLIGHT_MATRIX + 9, **settings)
    assert notices == []
    directions = np.random.default_rng(1).normal(size=(200, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    found = colors(table, code, directions)
    assert np.isfinite(found).all() and (found >= 0.0).all()
    zenith, towards_sun, away = colors(table, code, np.array([(0.0, 0.0, 1.0), (0.0, 0.6, 0.8), (0.0, -0.6, 0.8)]))
    assert zenith[2] > zenith[0] and (towards_sun > away).all()


def test_a_kind_of_sky_that_is_not_known_is_named() -> None:
    _, notices = sky_table(_MAP_SIZE, sky_type="OF_TOMORROW")
    assert [notice.problem for notice in notices] == ["sky_type 'OF_TOMORROW' is not supported"]
