# SPDX-License-Identifier: GPL-3.0-or-later
"""Cycles' shadow caustics: a scene asks for them once it names a light, a caster and a receiver."""

from __future__ import annotations

import itertools
from typing import Any

import pytest


@pytest.fixture
def scene(blender: Any) -> Any:
    """A plane, a ball and a lamp."""
    blender.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    blender.ops.mesh.primitive_plane_add()
    blender.ops.mesh.primitive_ico_sphere_add(location=(0.0, 0.0, 2.0))
    blender.ops.object.light_add(type="POINT", location=(0.0, 0.0, 4.0))
    blender.ops.object.camera_add(location=(0.0, -8.0, 4.0))
    blender.context.scene.camera = blender.context.object
    return blender.context.scene


def asks(blender: Any) -> bool:
    from addon.export import export_scene

    answer = export_scene(blender.context.evaluated_depsgraph_get()).asks_for_caustics
    assert isinstance(answer, bool)
    return answer


def test_all_three_are_needed(scene: Any, blender: Any) -> None:
    plane, ball, lamp = (scene.objects[name] for name in ("Plane", "Icosphere", "Point"))
    for light, caster, receiver in itertools.product((False, True), repeat=3):
        lamp.data.cycles.is_caustics_light = light
        ball.cycles.is_caustics_caster = caster
        plane.cycles.is_caustics_receiver = receiver
        assert asks(blender) == (light and caster and receiver)


def test_the_world_may_be_the_light(scene: Any, blender: Any) -> None:
    scene.objects["Icosphere"].cycles.is_caustics_caster = True
    scene.objects["Plane"].cycles.is_caustics_receiver = True
    scene.world = blender.data.worlds.new("World")
    assert not asks(blender)
    scene.world.cycles.is_caustics_light = True
    assert asks(blender)
