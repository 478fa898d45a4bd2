# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' Fast GI Approximation as scenes, worlds and objects have it."""

from __future__ import annotations

from typing import Any

import pytest

from engine.scene.fast_gi import FastGi
from tests.helpers.blender_scenes import export

bpy = pytest.importorskip("bpy")


@pytest.fixture
def fast(cube_scene: Any) -> Any:
    """A scene with a world that wants it."""
    cube_scene.world = bpy.data.worlds.new("World")
    cube_scene.world.light_settings.ao_factor = 0.5
    cycles = cube_scene.cycles
    cycles.use_fast_gi, cycles.fast_gi_method = True, "REPLACE"
    cycles.ao_bounces, cycles.ao_bounces_render = 2, 3
    return cube_scene


def test_the_method_says_what_the_factor_is_of(fast: Any) -> None:
    assert export().fast_gi == FastGi(bounces=3, background=0.5)
    fast.cycles.fast_gi_method = "ADD"
    fast.update_tag()
    assert export().fast_gi == FastGi(added=0.5)


@pytest.mark.parametrize("lacking", ["switch", "factor", "world", "cycles"])
def test_nothing_is_done_where_something_lacks(fast: Any, lacking: str) -> None:
    if lacking == "switch":
        fast.cycles.use_fast_gi = False
    elif lacking == "factor":
        fast.world.light_settings.ao_factor = 0.0
    elif lacking == "world":
        fast.world = None
    else:
        fast.neuralguide.use_cycles_settings = False
    assert not export().fast_gi.is_used


def test_a_layer_that_leaves_the_world_out_has_its_factor_all_the_same(fast: Any) -> None:
    fast.view_layers[0].use_sky = False
    assert export().world is None and export().fast_gi.background == 0.5


def test_instances_look_as_far_as_they_say_or_else_what_instances_them(fast: Any) -> None:
    cube = fast.objects["Cube"]
    cube.cycles.ao_distance = 0.0
    holder = bpy.data.collections.new("Held")
    holder.objects.link(cube)
    empty = bpy.data.objects.new("Empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", holder
    empty.location = (5.0, 0.0, 0.0)
    empty.cycles.ao_distance = 4.0
    fast.collection.objects.link(empty)
    assert sorted(export().instances.occlusion_distance.tolist()) == [0.0, 4.0]
    cube.cycles.ao_distance = 2.0
    cube.update_tag()
    assert export().instances.occlusion_distance.tolist() == [2.0, 2.0]
