# SPDX-License-Identifier: GPL-3.0-or-later
"""A random scene: a function of its seed."""

from __future__ import annotations

from random import Random
from typing import Any

from tests.fuzz.node_trees import LIGHT, TreeMaker, node_tree
from tests.fuzz.numbers import chance, color
from tests.fuzz.objects import add_camera, add_copies, add_floor, add_lamp, add_material, add_mesh
from tests.fuzz.settings import choose_settings

WIDTH, HEIGHT = 16, 12


def make_scene(seed: int) -> Any:
    """Build the scene of a seed in an empty file; the add-on is registered. Returns Blender's scene."""
    import bpy

    bpy.ops.wm.read_factory_settings(use_empty=True)
    random = Random(seed)
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = WIDTH, HEIGHT, 100
    # What gives notices spoils the comparison with Cycles, so that it has scenes of its own.
    maker = TreeMaker(random, has_reported=chance(random, 0.1))
    _add_world(random, scene, maker)
    materials = [add_material(random, maker) for _ in range(random.randint(1, 3))]
    items = [add_mesh(random, materials) for _ in range(random.randint(1, 4))]
    if chance(random, 0.7):
        add_floor(random, random.choice(materials))
    add_copies(random, items)
    for _ in range(random.choice((0, 1, 1, 2, 3))):
        add_lamp(random, maker)
    add_camera(random)
    choose_settings(random, scene)
    bpy.context.view_layer.update()
    return scene


def _add_world(random: Random, scene: Any, maker: TreeMaker) -> None:
    import bpy

    if chance(random, 0.1):
        return
    world = scene.world = bpy.data.worlds.new("World")
    tree = node_tree(world)
    if chance(random, 0.5):
        tree.nodes["Background"].inputs["Color"].default_value = color(random)
        tree.nodes["Background"].inputs["Strength"].default_value = random.choice((0.0, 0.3, 1.0, 1.0, 1000.0))
    else:
        maker.fill(tree, "ShaderNodeOutputWorld", LIGHT)
    if chance(random, 0.04):
        maker.add_volume(tree, alone=False)
    world.cycles.sampling_method = random.choice(("AUTOMATIC", "NONE", "MANUAL"))
    world.cycles.max_bounces = random.choice((1024, 1024, 1024, 0, 1))
    visibility = world.cycles_visibility
    for name in ("camera", "diffuse", "glossy", "transmission", "scatter"):
        setattr(visibility, name, not chance(random, 0.05))
