# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes of caustics: bodies of glass are closed, lamps have Blender's default size, no path is cut short."""

from __future__ import annotations

import math
from typing import Any

import pytest

from benchmarks.scenes import SCENES, build
from benchmarks.scenes.caustic_shapes import rounded
from benchmarks.scenes.caustics import BOUNCES, ROUGHNESSES

NAMES = sorted(name for name, scene in SCENES.items() if scene.group == "caustics")
#: Sheets that are no boundary of a body.
SHEETS = ("Table", "Floor", "Wall", "Water", "Left", "Right", "Front", "Back")


def _volume_and_open_edges(data: Any) -> tuple[float, int]:
    import bmesh

    grid = bmesh.new()
    grid.from_mesh(data)
    volume, count = grid.calc_volume(signed=True), sum(not edge.is_manifold for edge in grid.edges)
    grid.free()
    return volume, count


def test_all_that_were_asked_for_are_there() -> None:
    for name in ("glass", "ring", "pool", "pool-above", "lamp", "lamp-frosted", "jewels", "jewels-dispersive", "pane"):
        assert f"caustic-{name}" in NAMES
    assert [f"caustic-rough-{roughness:02d}" in NAMES for roughness in ROUGHNESSES] == [True] * len(ROUGHNESSES)
    assert (min(ROUGHNESSES), max(ROUGHNESSES)) == (0, 20)


@pytest.mark.parametrize("name", NAMES)
def test_bodies_are_closed_and_turned_outwards(blender: Any, name: str) -> None:
    build(name)
    bodies = [
        item for item in blender.context.scene.objects if item.type == "MESH" and not item.name.startswith(SHEETS)
    ]
    assert bodies or name.startswith("caustic-pool")
    for item in bodies:
        volume, open_edges = _volume_and_open_edges(item.data)
        assert open_edges == 0, item.name
        # A hollow is what a body lacks.
        assert (volume < 0.0) == item.name.startswith("Hollow"), item.name


@pytest.mark.parametrize("name", NAMES)
def test_lamps_have_blender_s_default_size_and_nothing_is_cut_off(blender: Any, name: str) -> None:
    build(name)
    lights = [item.data for item in blender.context.scene.objects if item.type == "LIGHT"]
    assert lights
    for light in lights:
        if light.type == "SUN":
            assert math.degrees(light.angle) == pytest.approx(0.526, abs=0.001)
        else:
            assert light.shadow_soft_size == pytest.approx(0.1)
    cycles = blender.context.scene.cycles
    assert cycles.max_bounces == cycles.diffuse_bounces == cycles.glossy_bounces == BOUNCES
    assert cycles.transmission_bounces == BOUNCES and cycles.blur_glossy == 0.0
    assert cycles.sample_clamp_direct == cycles.sample_clamp_indirect == 0.0
    assert cycles.caustics_reflective and cycles.caustics_refractive


def test_corners_are_rounded_within_their_edges() -> None:
    corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 0.02), (0.0, 0.02))
    points = rounded(corners, 0.1)
    assert points[0] == corners[0] and points[-1] == corners[-1]
    # The corners themselves are gone, and nothing is further out than they were.
    assert not set(corners[1:3]) & set(points)
    assert all(0.0 <= x <= 1.0 and 0.0 <= y <= 0.02 for x, y in points)
    heights = [y for x, y in points if x == pytest.approx(1.0)]
    assert heights == sorted(heights) and heights[0] < 0.5 * 0.02 < heights[-1]
