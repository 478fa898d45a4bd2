# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds the demo scene: an evening room whose lamps are all out of sight.

Warm light comes around a door ajar from a lamp in the next room, a lighting strip shines on the wall from behind a
panel, and the last of the sunset falls through slatted blinds. Nearly all that is seen is lit indirectly, much of it by
way of polished stone, bronze and glass. Everything comes from what Blender ships, or is made here.
"""

from __future__ import annotations

import math
import random
from collections.abc import Sequence
from pathlib import Path

import bpy

from . import materials

Vector = Sequence[float]


def _object(name: str, data: bpy.types.ID | None, material: bpy.types.Material | None = None) -> bpy.types.Object:
    item = bpy.data.objects.new(name, data)
    bpy.context.scene.collection.objects.link(item)
    if material is not None:
        data.materials.append(material)
    return item


def _box(name: str, low: Vector, high: Vector, material: bpy.types.Material, bevel: float = 0.0) -> bpy.types.Object:
    """An axis-aligned box, its origin in its middle."""
    half = [(b - a) / 2 for a, b in zip(low, high, strict=True)]
    corners = [(x * half[0], y * half[1], z * half[2]) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    mesh = bpy.data.meshes.new(name)
    mesh.from_pydata(corners, [], faces)
    item = _object(name, mesh, material)
    item.location = [(a + b) / 2 for a, b in zip(low, high, strict=True)]
    if bevel:
        modifier = item.modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments = bevel, 3
    return item


def _smooth(item: bpy.types.Object) -> bpy.types.Object:
    for polygon in item.data.polygons:
        polygon.use_smooth = True
    return item


def _primitive(operator: object, name: str, material: bpy.types.Material, **arguments: object) -> bpy.types.Object:
    operator(**arguments)  # type: ignore[operator]
    item = bpy.context.active_object
    item.name = name
    item.data.materials.append(material)
    return _smooth(item)


def _suzanne(
    name: str, material: bpy.types.Material, location: Vector, size: float, turn: float, levels: int = 2
) -> bpy.types.Object:
    item = _primitive(bpy.ops.mesh.primitive_monkey_add, name, material, size=size, location=location)
    item.rotation_euler = (math.radians(-14.0), 0.0, math.radians(turn))
    item.modifiers.new("Subdivision", "SUBSURF").render_levels = levels
    return item


def _room() -> None:
    """Two rooms with a doorway between them, and a window on the left."""
    wall = materials.plaster("Wall paint", (0.42, 0.40, 0.36))
    accent = materials.plaster("Accent paint", (0.36, 0.17, 0.10))
    ceiling = materials.plaster("Ceiling paint", (0.72, 0.70, 0.66))
    oak = materials.wood("Oak", (0.09, 0.035, 0.012), (0.30, 0.14, 0.055))
    _box("Floor", (-3.2, -6.2, -0.2), (3.2, 6.2, 0.0), materials.marble_tiles())
    _box("Ceiling", (-3.2, -6.2, 2.8), (3.2, 6.2, 3.0), ceiling)
    _box("Wall right", (3.0, -6.2, 0.0), (3.2, 6.2, 2.8), wall)
    _box("Wall behind camera", (-3.2, -6.2, 0.0), (3.2, -6.0, 2.8), wall)
    _box("Wall of the next room", (-3.2, 6.0, 0.0), (3.2, 6.2, 2.8), wall)
    # Back wall around the doorway (x 1.15 to 2.05, 2.1 high).
    _box("Back wall left", (-3.0, 3.0, 0.0), (1.15, 3.15, 2.8), accent)
    _box("Back wall right", (2.05, 3.0, 0.0), (3.0, 3.15, 2.8), accent)
    _box("Back wall above", (1.15, 3.0, 2.1), (2.05, 3.15, 2.8), accent)
    for x in (1.10, 2.05):
        _box("Door post", (x, 2.96, 0.0), (x + 0.05, 3.19, 2.15), oak, 0.006)
    _box("Lintel", (1.10, 2.96, 2.10), (2.10, 3.19, 2.15), oak, 0.006)
    door = _box("Door", (1.16, 2.98, 0.01), (2.04, 3.03, 2.09), oak, 0.006)
    door.data.transform(_translation(0.44, 0.0, 0.0))
    door.location = (1.16, 3.08, door.location.z)
    door.rotation_euler.z = math.radians(62.0)
    # Left wall around the window (y 0.2 to 1.7, z 0.7 to 2.3).
    _box("Left wall front", (-3.2, -6.2, 0.0), (-3.0, 0.2, 2.8), wall)
    _box("Left wall back", (-3.2, 1.7, 0.0), (-3.0, 6.2, 2.8), wall)
    _box("Left wall below", (-3.2, 0.2, 0.0), (-3.0, 1.7, 0.7), wall)
    _box("Left wall above", (-3.2, 0.2, 2.3), (-3.0, 1.7, 2.8), wall)
    slat = _box("Blind", (-3.12, 0.2, 0.72), (-3.04, 1.7, 0.726), oak)
    slat.rotation_euler.y = math.radians(-28.0)
    blind = slat.modifiers.new("Array", "ARRAY")
    blind.count, blind.use_relative_offset, blind.use_constant_offset = 23, False, True
    up = math.radians(28.0)
    blind.constant_offset_displace = (0.07 * math.sin(up), 0.0, 0.07 * math.cos(up))


def _translation(x: float, y: float, z: float) -> object:
    from mathutils import Matrix

    return Matrix.Translation((x, y, z))


def _lights() -> None:
    """None of them is in the picture."""
    data = bpy.data.lights.new("Lamp next door", "AREA")
    data.shape, data.size, data.energy = "DISK", 0.9, 520.0
    data.color = (1.0, 0.62, 0.33)
    next_door = _object("Lamp next door", data)
    next_door.location = (2.72, 4.75, 2.2)
    next_door.rotation_euler = (math.radians(-48.0), 0.0, math.radians(-40.0))

    panel_wood = materials.wood("Walnut", (0.05, 0.022, 0.011), (0.22, 0.105, 0.05))
    _box("Panel", (-2.35, 2.86, 0.95), (0.35, 2.90, 2.15), panel_wood, 0.008)
    glow = materials.lamp("Lighting strip", 3300.0, 16.0)
    _box("Strip above", (-2.2, 2.92, 1.94), (0.2, 2.95, 2.02), glow)
    _box("Strip below", (-2.2, 2.92, 1.08), (0.2, 2.95, 1.16), glow)

    world = bpy.data.worlds.new("Sunset")
    world.use_nodes = True
    bpy.context.scene.world = world
    tree = world.node_tree
    background = next(node for node in tree.nodes if node.type == "BACKGROUND")
    environment = tree.nodes.new("ShaderNodeTexEnvironment")
    folder = Path(bpy.utils.resource_path("LOCAL")) / "datafiles" / "studiolights" / "world"
    environment.image = bpy.data.images.load(str(folder / "sunset.exr"))
    environment.image.pack()
    turn = tree.nodes.new("ShaderNodeMapping")
    turn.inputs["Rotation"].default_value[2] = math.radians(200.0)
    place = tree.nodes.new("ShaderNodeTexCoord")
    tree.links.new(place.outputs["Generated"], turn.inputs["Vector"])
    tree.links.new(turn.outputs["Vector"], environment.inputs["Vector"])
    tree.links.new(environment.outputs["Color"], background.inputs["Color"])
    background.inputs["Strength"].default_value = 2.2


def _still_life() -> None:
    """What stands in the room."""
    stone = materials.plaster("Stone", (0.50, 0.47, 0.42))
    walnut = bpy.data.materials["Walnut"]
    _box("Plinth", (-0.34, 0.43, 0.0), (0.34, 1.11, 0.66), stone, 0.02)
    bronze = materials.metal("Bronze", (0.80, 0.46, 0.22), 0.16)
    _suzanne("Bronze head", bronze, (0.0, 0.77, 1.10), 1.0, 20.0)

    _box("Low table", (-1.95, -0.55, 0.36), (-0.75, 0.25, 0.42), walnut, 0.012)
    for x in (-1.90, -0.86):
        for y in (-0.48, 0.12):
            _box("Leg", (x, y, 0.0), (x + 0.06, y + 0.06, 0.36), walnut, 0.006)
    sphere = bpy.ops.mesh.primitive_uv_sphere_add
    clear = materials.glass("Glass", (0.97, 0.99, 0.98))
    _primitive(sphere, "Glass ball", clear, radius=0.20, segments=96, ring_count=48, location=(-1.02, -0.26, 0.62))
    _primitive(
        bpy.ops.mesh.primitive_torus_add,
        "Ring",
        materials.metal("Brass", (0.90, 0.66, 0.28), 0.08),
        major_radius=0.17,
        minor_radius=0.045,
        major_segments=96,
        minor_segments=32,
        location=(-1.42, -0.32, 0.465),
    )
    vase = _primitive(sphere, "Vase", materials.glaze(), radius=0.19, segments=96, ring_count=48)
    vase.location, vase.scale = (-1.60, 0.02, 0.70), (0.85, 0.85, 1.5)

    frosted = materials.glass("Frosted glass", (0.72, 0.93, 0.86), 0.18)
    small = _suzanne("Glass head", frosted, (0.80, -0.38, 0.33), 0.58, -16.0)
    small.location.z = 0.24
    _books()


def _books() -> None:
    """Instances of one book, with a colour each, stacked beside the plinth and leaning on the wall."""
    choose = random.Random(7)
    cover = materials.cloth_covers()
    book = _box("Book", (-0.15, -0.11, -0.02), (0.15, 0.11, 0.02), cover, 0.004)
    book.location = (0.0, -20.0, -1.0)
    book.hide_render = True
    height = 0.0
    for _ in range(9):
        thickness = choose.uniform(0.7, 1.5)
        item = _object("Book", book.data)
        item.scale = (choose.uniform(0.85, 1.15), choose.uniform(0.9, 1.1), thickness)
        item.rotation_euler.z = math.radians(choose.uniform(-16.0, 16.0) + 20.0)
        shift = choose.uniform(-0.02, 0.02), choose.uniform(-0.02, 0.02)
        item.location = (0.80 + shift[0], 1.35 + shift[1], height + 0.02 * thickness)
        height += 0.04 * thickness
        modifier = item.modifiers.new("Bevel", "BEVEL")
        modifier.width, modifier.segments = 0.004, 2


def _camera() -> None:
    data = bpy.data.cameras.new("Camera")
    data.lens = 31.0
    data.dof.use_dof = True
    data.dof.focus_distance = 3.9
    data.dof.aperture_fstop = 2.0
    camera = _object("Camera", data)
    camera.location = (0.22, -3.45, 1.32)
    camera.rotation_euler = (math.radians(82.0), 0.0, math.radians(3.5))
    bpy.context.scene.camera = camera


def build(width: int = 640, height: int = 360, samples: int = 128) -> bpy.types.Scene:
    """Replace the open file by the demo scene, ready to render with NEURALGUIDE, which must be registered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    _room()
    _lights()
    _still_life()
    _camera()
    render = scene.render
    render.engine = "NEURALGUIDE"
    render.resolution_x, render.resolution_y, render.resolution_percentage = width, height, 100
    cycles = scene.cycles  # what both engines go by
    cycles.samples, cycles.use_adaptive_sampling, cycles.use_denoising = samples, False, False
    cycles.max_bounces = cycles.diffuse_bounces = cycles.glossy_bounces = cycles.transmission_bounces = 12
    cycles.sample_clamp_indirect = 6.0
    scene.view_settings.look = "AgX - Medium High Contrast"
    scene.view_settings.exposure = 1.7
    return scene
