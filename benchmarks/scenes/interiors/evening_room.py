# SPDX-License-Identifier: GPL-3.0-or-later
"""An evening room whose lamps are all out of sight.

Warm light comes around a door ajar from a lamp in the next room, a lighting strip shines on the wall from behind a
panel, and the last of the sunset falls through slatted blinds. Nearly all that is seen is lit indirectly, much of it by
way of polished stone, bronze and glass. Everything comes from what Blender ships, or is made here.
"""

from __future__ import annotations

import math
import random
from pathlib import Path

import bpy
from mathutils import Matrix

from benchmarks.scenes.interiors import materials
from benchmarks.scenes.interiors.rendering import set_up
from benchmarks.scenes.interiors.shapes import add_object, box, primitive, suzanne


def _room() -> None:
    """Two rooms with a doorway between them, and a window on the left."""
    wall = materials.plaster("Wall paint", (0.42, 0.40, 0.36))
    accent = materials.plaster("Accent paint", (0.36, 0.17, 0.10))
    ceiling = materials.plaster("Ceiling paint", (0.72, 0.70, 0.66))
    oak = materials.wood("Oak", (0.09, 0.035, 0.012), (0.30, 0.14, 0.055))
    box("Floor", (-3.2, -6.2, -0.2), (3.2, 6.2, 0.0), materials.marble_tiles())
    box("Ceiling", (-3.2, -6.2, 2.8), (3.2, 6.2, 3.0), ceiling)
    box("Wall right", (3.0, -6.2, 0.0), (3.2, 6.2, 2.8), wall)
    box("Wall behind camera", (-3.2, -6.2, 0.0), (3.2, -6.0, 2.8), wall)
    box("Wall of the next room", (-3.2, 6.0, 0.0), (3.2, 6.2, 2.8), wall)
    # Back wall around the doorway (x 1.15 to 2.05, 2.1 high).
    box("Back wall left", (-3.0, 3.0, 0.0), (1.15, 3.15, 2.8), accent)
    box("Back wall right", (2.05, 3.0, 0.0), (3.0, 3.15, 2.8), accent)
    box("Back wall above", (1.15, 3.0, 2.1), (2.05, 3.15, 2.8), accent)
    for x in (1.10, 2.05):
        box("Door post", (x, 2.96, 0.0), (x + 0.05, 3.19, 2.15), oak, 0.006)
    box("Lintel", (1.10, 2.96, 2.10), (2.10, 3.19, 2.15), oak, 0.006)
    door = box("Door", (1.16, 2.98, 0.01), (2.04, 3.03, 2.09), oak, 0.006)
    door.data.transform(Matrix.Translation((0.44, 0.0, 0.0)))
    door.location = (1.16, 3.08, door.location.z)
    door.rotation_euler.z = math.radians(62.0)
    # Left wall around the window (y 0.2 to 1.7, z 0.7 to 2.3).
    box("Left wall front", (-3.2, -6.2, 0.0), (-3.0, 0.2, 2.8), wall)
    box("Left wall back", (-3.2, 1.7, 0.0), (-3.0, 6.2, 2.8), wall)
    box("Left wall below", (-3.2, 0.2, 0.0), (-3.0, 1.7, 0.7), wall)
    box("Left wall above", (-3.2, 0.2, 2.3), (-3.0, 1.7, 2.8), wall)
    slat = box("Blind", (-3.12, 0.2, 0.72), (-3.04, 1.7, 0.726), oak)
    slat.rotation_euler.y = math.radians(-28.0)
    blind = slat.modifiers.new("Array", "ARRAY")
    blind.count, blind.use_relative_offset, blind.use_constant_offset = 23, False, True
    up = math.radians(28.0)
    blind.constant_offset_displace = (0.07 * math.sin(up), 0.0, 0.07 * math.cos(up))


def _lights() -> None:
    """None of them is in the picture."""
    data = bpy.data.lights.new("Lamp next door", "AREA")
    data.shape, data.size, data.energy = "DISK", 0.9, 520.0
    data.color = (1.0, 0.62, 0.33)
    next_door = add_object("Lamp next door", data)
    next_door.location = (2.72, 4.75, 2.2)
    next_door.rotation_euler = (math.radians(-48.0), 0.0, math.radians(-40.0))

    panel_wood = materials.wood("Walnut", (0.05, 0.022, 0.011), (0.22, 0.105, 0.05))
    box("Panel", (-2.35, 2.86, 0.95), (0.35, 2.90, 2.15), panel_wood, 0.008)
    glow = materials.lamp("Lighting strip", 3300.0, 16.0)
    box("Strip above", (-2.2, 2.92, 1.94), (0.2, 2.95, 2.02), glow)
    box("Strip below", (-2.2, 2.92, 1.08), (0.2, 2.95, 1.16), glow)

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
    box("Plinth", (-0.34, 0.43, 0.0), (0.34, 1.11, 0.66), stone, 0.02)
    bronze = materials.metal("Bronze", (0.80, 0.46, 0.22), 0.16)
    suzanne("Bronze head", bronze, (0.0, 0.77, 1.10), 1.0, 20.0)

    box("Low table", (-1.95, -0.55, 0.36), (-0.75, 0.25, 0.42), walnut, 0.012)
    for x in (-1.90, -0.86):
        for y in (-0.48, 0.12):
            box("Leg", (x, y, 0.0), (x + 0.06, y + 0.06, 0.36), walnut, 0.006)
    sphere = bpy.ops.mesh.primitive_uv_sphere_add
    clear = materials.glass("Glass", (0.97, 0.99, 0.98))
    primitive(sphere, "Glass ball", clear, radius=0.20, segments=96, ring_count=48, location=(-1.02, -0.26, 0.62))
    primitive(
        bpy.ops.mesh.primitive_torus_add,
        "Ring",
        materials.metal("Brass", (0.90, 0.66, 0.28), 0.08),
        major_radius=0.17,
        minor_radius=0.045,
        major_segments=96,
        minor_segments=32,
        location=(-1.42, -0.32, 0.465),
    )
    vase = primitive(sphere, "Vase", materials.glaze(), radius=0.19, segments=96, ring_count=48)
    vase.location, vase.scale = (-1.60, 0.02, 0.70), (0.85, 0.85, 1.5)

    frosted = materials.glass("Frosted glass", (0.72, 0.93, 0.86), 0.18)
    small = suzanne("Glass head", frosted, (0.80, -0.38, 0.33), 0.58, -16.0)
    small.location.z = 0.24
    _books()


def _books() -> None:
    """Instances of one book, with a colour each, stacked beside the plinth and leaning on the wall."""
    choose = random.Random(7)
    cover = materials.cloth_covers()
    book = box("Book", (-0.15, -0.11, -0.02), (0.15, 0.11, 0.02), cover, 0.004)
    book.location = (0.0, -20.0, -1.0)
    book.hide_render = True
    height = 0.0
    for _ in range(9):
        thickness = choose.uniform(0.7, 1.5)
        item = add_object("Book", book.data)
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
    camera = add_object("Camera", data)
    camera.location = (0.22, -3.45, 1.32)
    camera.rotation_euler = (math.radians(82.0), 0.0, math.radians(3.5))
    bpy.context.scene.camera = camera


def _fog() -> None:
    """Haze in both rooms, which scatters forwards: it shows the light that comes through the door."""
    haze = bpy.data.materials.new("Haze")
    if haze.node_tree is None:
        haze.use_nodes = True
    tree = haze.node_tree
    tree.nodes.clear()
    scatter, output = tree.nodes.new("ShaderNodeVolumeScatter"), tree.nodes.new("ShaderNodeOutputMaterial")
    scatter.inputs["Color"].default_value = (0.95, 0.95, 0.95, 1.0)
    scatter.inputs["Density"].default_value, scatter.inputs["Anisotropy"].default_value = 0.05, 0.5
    tree.links.new(scatter.outputs["Volume"], output.inputs["Volume"])
    box("Haze", (-3.1, -6.1, -0.1), (3.1, 6.1, 2.9), haze)


def build(width: int = 640, height: int = 360, samples: int = 128, *, is_foggy: bool = False) -> bpy.types.Scene:
    """Replace the open file by the evening room, ready to render with NEURALGUIDE, which must be registered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    _room()
    _lights()
    _still_life()
    _camera()
    set_up(scene, (width, height), samples, bounces=12, clamp_indirect=6.0, exposure=1.7)
    if is_foggy:
        _fog()
        scene.cycles.volume_bounces = 8
    return scene
