# SPDX-License-Identifier: GPL-3.0-or-later
"""Random scenes: shapes, materials, lamps, worlds, cameras and settings."""

from __future__ import annotations

import random
from typing import Any

import bpy

from tests.helpers.blender_scenes import empty_scene
from tests.helpers.fuzz.graphs import GraphMaker

_SHAPES = ("cube", "uv_sphere", "plane", "torus", "cone", "monkey")
#: What is open has no inside: Cycles' medium behind it goes on for ever, ours ends (docs/differences.md).
_OPEN = {"plane", "monkey"}
_VISIBILITY = (
    "visible_camera", "visible_diffuse", "visible_glossy", "visible_transmission", "visible_volume_scatter",
    "visible_shadow",
)  # fmt: skip
_METHODS = ("OFF", "OFF", "AUTO", "VMM", "VMM_RIS", "SDTREE")


def make_scene(seed: int) -> Any:
    """The scene of a seed, which is the only one in the file then."""
    numbers = random.Random(seed)
    scene = empty_scene()
    graphs = GraphMaker(numbers, numbers.choice((0.0, 0.05, 0.3)))
    _set_camera(scene, numbers)
    materials = [_material(graphs, numbers, index) for index in range(numbers.randint(1, 3))]
    floor = _add("plane", materials, numbers)
    floor.scale, floor.location = (5.0, 5.0, 1.0), (0.0, 0.0, -1.0)
    shown = [_add(numbers.choice(_SHAPES), materials, numbers) for _ in range(numbers.randint(1, 4))]
    for item in shown:
        _place(item, shown, numbers)
    for index in range(numbers.choice((0, 1, 1, 2))):
        _lamp(scene, numbers, index)
    _world(scene, graphs, numbers)
    _settings(scene, numbers)
    return scene


def _set_camera(scene: Any, numbers: random.Random) -> None:
    camera = scene.camera
    camera.location, camera.rotation_euler = (0.0, -6.0, 3.0), (1.1, 0.0, 0.0)
    camera.data.lens = numbers.uniform(20.0, 50.0)
    kind = numbers.random()
    if kind < 0.1:
        camera.data.type, camera.data.ortho_scale = "ORTHO", 5.0
    elif kind < 0.2:
        camera.data.dof.use_dof, camera.data.dof.focus_distance = True, numbers.uniform(0.5, 9.0)
        camera.data.dof.aperture_fstop = numbers.choice((0.1, 1.0, 8.0))
        camera.data.dof.aperture_blades = numbers.choice((0, 3, 6))


def _new_tree(owner: Any) -> Any:
    if owner.node_tree is None:
        owner.use_nodes = True
    owner.node_tree.nodes.clear()
    return owner.node_tree


def _material(graphs: GraphMaker, numbers: random.Random, index: int) -> Any:
    material = bpy.data.materials.new(f"Material {index}")
    tree = _new_tree(material)
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    # Blender links a value to a shader: as strange as it is, files have it.
    of = graphs.value(tree) if numbers.random() < 0.05 else graphs.surface(tree)
    tree.links.new(of, output.inputs["Surface"])
    if numbers.random() < 0.1:
        tree.links.new(graphs.volume(tree), output.inputs["Volume"])
    return material


def _has_volume(material: Any) -> bool:
    return any(link.to_socket.name == "Volume" for link in material.node_tree.links)


def _add(shape: str, materials: list[Any], numbers: random.Random) -> Any:
    getattr(bpy.ops.mesh, f"primitive_{shape}_add")()
    made = bpy.context.object
    fitting = [material for material in materials if shape not in _OPEN or not _has_volume(material)]
    if fitting:
        made.data.materials.append(numbers.choice(fitting))
    if numbers.random() < 0.5:
        for polygon in made.data.polygons:
            polygon.use_smooth = numbers.random() < 0.8
    if numbers.random() < 0.3:
        group = made.vertex_groups.new(name="Group")
        group.add(range(len(made.data.vertices) // 2), 0.7, "REPLACE")
    return made


def _place(item: Any, shown: list[Any], numbers: random.Random) -> None:
    item.location = [numbers.uniform(-1.5, 1.5) for _ in range(3)]
    item.rotation_euler = [numbers.uniform(0.0, 6.3) for _ in range(3)]
    item.scale = [numbers.choice((1.0, 1.0, 0.5, -0.7, 2.0, 0.001)) for _ in range(3)]
    item.color = [numbers.random() for _ in range(4)]
    if item is not shown[0] and numbers.random() < 0.2:
        item.parent = shown[0]
    for name in _VISIBILITY:
        if numbers.random() < 0.04:
            setattr(item, name, False)
    item.is_holdout = numbers.random() < 0.04
    item.is_shadow_catcher = numbers.random() < 0.03


def _lamp(scene: Any, numbers: random.Random, index: int) -> None:
    kind = numbers.choice(("POINT", "SUN", "SPOT", "AREA"))
    lamp = bpy.data.lights.new(f"Lamp {index}", kind)
    lamp.energy = 10.0 ** numbers.uniform(-1.0, 0.7) if kind == "SUN" else 10.0 ** numbers.uniform(0.0, 3.0)
    lamp.color = [numbers.random() for _ in range(3)]
    if kind == "SUN":
        lamp.angle = numbers.choice((0.0, 0.1, 0.5, 3.0))
    elif kind == "AREA":
        lamp.shape = numbers.choice(("SQUARE", "RECTANGLE", "DISK", "ELLIPSE"))
        lamp.size, lamp.size_y = numbers.choice((0.01, 1.0, 3.0)), numbers.choice((0.1, 2.0))
        lamp.spread = numbers.choice((3.14159, 1.0, 0.2))
    else:
        lamp.shadow_soft_size = numbers.choice((0.0, 0.1, 1.0))
    shown = bpy.data.objects.new(lamp.name, lamp)
    shown.location = [numbers.uniform(-3.0, 3.0), numbers.uniform(-3.0, 3.0), numbers.uniform(1.0, 4.0)]
    shown.rotation_euler = [numbers.uniform(-0.8, 0.8) for _ in range(3)]
    scene.collection.objects.link(shown)


def _world(scene: Any, graphs: GraphMaker, numbers: random.Random) -> None:
    kind = numbers.random()
    if kind < 0.3:
        return
    scene.world = bpy.data.worlds.new("World")
    tree = _new_tree(scene.world)
    output = tree.nodes.new("ShaderNodeOutputWorld")
    if kind < 0.35:
        tree.links.new(graphs.value(tree), output.inputs["Surface"])
        return
    background = tree.nodes.new("ShaderNodeBackground")
    background.inputs["Color"].default_value = (*(numbers.random() for _ in range(3)), 1.0)
    background.inputs["Strength"].default_value = numbers.choice((0.0, 0.3, 1.0))
    if kind < 0.55:
        tree.links.new(graphs.value(tree), background.inputs["Color"])
    tree.links.new(background.outputs[0], output.inputs["Surface"])


def _settings(scene: Any, numbers: random.Random) -> None:
    cycles, ours = scene.cycles, scene.neuralguide
    cycles.max_bounces = numbers.choice((0, 1, 3, 12))
    for kind in ("diffuse", "glossy", "transmission", "transparent_max", "volume"):
        setattr(cycles, f"{kind}_bounces", numbers.choice((0, 1, 4, 8)))
    cycles.caustics_reflective, cycles.caustics_refractive = numbers.random() < 0.7, numbers.random() < 0.7
    cycles.blur_glossy = numbers.choice((0.0, 1.0, 10.0))
    cycles.sample_clamp_direct = numbers.choice((0.0, 0.0, 3.0))
    cycles.sample_clamp_indirect = numbers.choice((0.0, 10.0, 1.0))
    cycles.use_light_tree = numbers.random() < 0.7
    cycles.film_exposure = numbers.choice((1.0, 1.0, 0.2, 5.0))
    scene.render.film_transparent = numbers.random() < 0.2
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = 16, 12, 100
    ours.guiding_method = numbers.choice(_METHODS)
    ours.radiance_cache = numbers.choice(("OFF", "OFF", "OFF", "CONVERGING"))
