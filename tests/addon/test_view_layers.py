# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view layer overrides and leaves out, beside Cycles in the same process.

Means of cells of 4 x 4 pixels, of colours and alpha, agree within 4% of the picture's brightest cell: two renderers
with 64 samples of a sun and a sky. What a rule changes is at least five times that.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.helpers.pass_scenes import add_object, make_material, render_both


def cells(images: dict[str, np.ndarray]) -> np.ndarray:
    """Means, float64 (4, 8, 4)."""
    picture = np.stack([images[f"ViewLayer.Combined.{channel}"] for channel in "RGBA"], axis=-1)
    return picture.reshape(4, 4, 8, 4, 4).mean(axis=(1, 3))


@pytest.fixture
def room(cube_scene: Any) -> Any:
    """A red cube on a floor, under a sky; beside it a glowing one in a collection of its own, "Side"."""
    import bpy

    scene = cube_scene

    def red(tree: Any) -> Any:
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (0.8, 0.1, 0.1, 1.0)
        return node.outputs[0]

    def glow(tree: Any) -> Any:
        node = tree.nodes.new("ShaderNodeEmission")
        node.inputs["Color"].default_value = (0.1, 0.9, 0.2, 1.0)
        return node.outputs[0]

    scene.objects["Cube"].data.materials.append(make_material("Red", red))
    add_object("Floor", "plane", size=20, location=(0.0, 0.0, -1.0))
    side = bpy.data.collections.new("Side")
    scene.collection.children.link(side)
    glowing = add_object("Glow", "cube", make_material("Glow", glow), size=1.5, location=(2.2, -0.5, 0.0))
    scene.collection.objects.unlink(glowing)
    side.objects.link(glowing)
    scene.world = bpy.data.worlds.new("Sky")
    if scene.world.node_tree is None:
        scene.world.use_nodes = True
    scene.world.node_tree.nodes["Background"].inputs["Color"].default_value = (0.3, 0.3, 0.5, 1.0)
    scene.cycles.max_bounces = 3
    return scene


def override_material(scene: Any) -> None:
    def blue(tree: Any) -> Any:
        node = tree.nodes.new("ShaderNodeBsdfDiffuse")
        node.inputs["Color"].default_value = (0.1, 0.2, 0.9, 1.0)
        return node.outputs[0]

    scene.view_layers[0].material_override = make_material("Blue", blue)


def hold_out(scene: Any) -> None:
    scene.view_layers[0].layer_collection.children["Side"].holdout = True


def show_indirectly(scene: Any) -> None:
    scene.view_layers[0].layer_collection.children["Side"].indirect_only = True


def exclude(scene: Any) -> None:
    scene.view_layers[0].layer_collection.children["Side"].exclude = True


def leave_out_sky(scene: Any) -> None:
    scene.view_layers[0].use_sky = False


def leave_out_surfaces(scene: Any) -> None:
    scene.view_layers[0].use_solid = False


def override_world(scene: Any) -> None:
    import bpy

    layer = scene.view_layers[0]
    if not hasattr(layer, "world_override"):
        pytest.skip("Blender 4.3 has it")
    layer.world_override = bpy.data.worlds.new("Other")
    if layer.world_override.node_tree is None:
        layer.world_override.use_nodes = True
    layer.world_override.node_tree.nodes["Background"].inputs["Color"].default_value = (0.9, 0.4, 0.1, 1.0)


@pytest.mark.parametrize(
    "rule",
    [
        override_material, hold_out, show_indirectly, exclude, leave_out_sky, leave_out_surfaces, override_world,
    ],
)
def test_a_rule_of_the_view_layer_is_that_of_cycles(
    room: Any, tmp_path: Path, rule: Callable[[Any], None]
) -> None:
    (before, _), _ = render_both(room, tmp_path, 64)
    rule(room)
    (ours, _), (theirs, _) = render_both(room, tmp_path, 64)
    brightest = cells(theirs).max()
    np.testing.assert_allclose(cells(ours), cells(theirs), rtol=0.0, atol=0.04 * brightest)
    assert np.abs(cells(ours) - cells(before)).max() > 0.2 * brightest
    mean = np.abs((cells(ours) - cells(theirs)).mean(axis=(0, 1)))
    assert (mean < 0.01 * brightest).all()


def test_mist_is_that_of_the_world_that_the_layer_shows(room: Any, tmp_path: Path) -> None:
    room.view_layers[0].use_pass_mist = True
    room.world.mist_settings.start, room.world.mist_settings.depth = 2.0, 6.0
    override_world(room)
    other = room.view_layers[0].world_override.mist_settings
    other.start, other.depth = 4.0, 20.0
    (ours, _), (theirs, _) = render_both(room, tmp_path, 64)
    np.testing.assert_allclose(ours["ViewLayer.Mist.Z"].mean(), theirs["ViewLayer.Mist.Z"].mean(), rtol=0.01)
