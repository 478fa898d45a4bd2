# SPDX-License-Identifier: GPL-3.0-or-later
"""A study that is lit by lamps which nothing in it sees.

Strips in a cove shine on the ceiling from behind its edge, and a lamp in the hall shines past a door that is ajar. All
light in the picture has been scattered at least once before it falls on what is seen. Everything is made here.
"""

from __future__ import annotations

import math
import random

import bpy

from benchmarks.scenes.interiors import materials
from benchmarks.scenes.interiors.rendering import set_up
from benchmarks.scenes.interiors.shapes import add_object, box, hang, leaf, primitive, smooth, suzanne, turned

#: Inside of the study: from, to [m]. The camera looks along y.
_LOW, _HIGH = (-2.7, -3.4, 0.0), (2.7, 2.4, 3.0)
#: Underside of the lowered ceiling, and its distance from the walls.
_PANEL_HEIGHT, _COVE = 2.62, 0.42
_THICK = 0.14


def _shell() -> None:
    """Study and hall: floor, walls, the doorway between them, ceiling with a cove.

    No two faces in sight lie in one plane: Cycles shows such faces black.
    """
    (x0, y0, z0), (x1, y1, z1) = _LOW, _HIGH
    hall_end = y1 + 2.6
    wall = materials.plaster("Wall paint", (0.50, 0.52, 0.44))
    white = materials.plaster("White paint", (0.80, 0.78, 0.74))
    gloss = materials.paint("Enamel", (0.78, 0.75, 0.69), 0.35)
    box("Floor", (x0 - _THICK, y0 - _THICK, -0.1), (x1 + _THICK, hall_end + _THICK, z0), materials.planks())
    box("Ceiling", (x0 - _THICK, y0 - _THICK, z1), (x1 + _THICK, hall_end + _THICK, z1 + 0.1), white)
    for name, low, high in (
        ("Wall left", (x0 - _THICK, y0, z0), (x0, hall_end, z1)),
        ("Wall right", (x1, y0, z0), (x1 + _THICK, hall_end, z1)),
        ("Wall behind camera", (x0 - _THICK, y0 - _THICK, z0), (x1 + _THICK, y0, z1)),
        ("Wall of the hall", (x0 - _THICK, hall_end, z0), (x1 + _THICK, hall_end + _THICK, z1)),
        # Around the doorway.
        ("Back wall left", (x0, y1, z0), (1.25, y1 + _THICK, z1)),
        ("Back wall right", (2.15, y1, z0), (x1, y1 + _THICK, z1)),
        ("Back wall above", (1.25, y1, 2.12), (2.15, y1 + _THICK, z1)),
    ):
        box(name, low, high, wall)
    for name, low, high in (
        ("Skirting back", (x0, y1 - 0.018, z0), (1.17, y1, 0.14)),
        ("Skirting left", (x0, y0, z0), (x0 + 0.018, y1 - 0.018, 0.14)),
        ("Skirting right", (x1 - 0.018, y0, z0), (x1, y1 - 0.018, 0.14)),
        ("Frame left", (1.17, y1 - 0.03, z0), (1.27, y1 + _THICK + 0.03, 2.098)),
        ("Frame right", (2.13, y1 - 0.03, z0), (2.23, y1 + _THICK + 0.03, 2.098)),
        ("Frame above", (1.17, y1 - 0.03, 2.10), (2.23, y1 + _THICK + 0.03, 2.22)),
    ):
        box(name, low, high, gloss, 0.006)
    door = box("Door", (1.28, y1 - 0.03, 0.01), (2.12, y1 + 0.015, 2.09), gloss, 0.004)
    hang(door, (2.12, y1, door.location.z), math.radians(38.0))
    knob = primitive(
        bpy.ops.mesh.primitive_uv_sphere_add, "Knob", materials.metal("Brass", (0.90, 0.66, 0.28), 0.18), radius=0.032
    )
    knob.parent, knob.location = door, (-0.76, -0.09, 0.0)
    panel = (x0 + _COVE, y0 + _COVE, _PANEL_HEIGHT), (x1 - _COVE, y1 - _COVE, _PANEL_HEIGHT + 0.05)
    box("Lowered ceiling", *panel, white)


def _lamps() -> None:
    """Strips on top of the lowered ceiling, and a lamp beside the door in the hall: none is seen from the study."""
    (x0, y0, _), (x1, y1, _) = _LOW, _HIGH
    glow = materials.lamp("Cove light", 4300.0, 46.0)
    inset, low, high = _COVE + 0.14, _PANEL_HEIGHT + 0.055, _PANEL_HEIGHT + 0.095
    for name, start, end in (
        ("Strip back", (x0 + inset, y1 - inset - 0.05), (x1 - inset, y1 - inset)),
        ("Strip left", (x0 + inset, y0 + inset), (x0 + inset + 0.05, y1 - inset - 0.06)),
        ("Strip right", (x1 - inset - 0.05, y0 + inset), (x1 - inset, y1 - inset - 0.06)),
    ):
        box(name, (*start, low), (*end, high), glow)
    lamp = bpy.data.lights.new("Hall lamp", "AREA")
    lamp.shape, lamp.size, lamp.energy, lamp.color = "DISK", 0.5, 420.0, (1.0, 0.66, 0.36)
    item = add_object("Hall lamp", lamp)
    item.location = (-0.9, y1 + 1.5, 2.5)
    item.rotation_euler = (math.radians(20.0), math.radians(-58.0), 0.0)


def _console() -> None:
    """A sideboard at the back wall with what stands on it, and a painting above."""
    y1 = _HIGH[1]
    walnut = materials.wood("Walnut", (0.05, 0.022, 0.011), (0.20, 0.10, 0.05))
    box("Sideboard", (-1.95, y1 - 0.50, 0.16), (0.35, y1 - 0.03, 0.80), walnut, 0.012)
    for x in (-1.85, 0.19):
        for y in (y1 - 0.46, y1 - 0.13):
            box("Leg", (x, y, 0.0), (x + 0.06, y + 0.06, 0.16), walnut, 0.006)
    for x in (-1.17, -0.40):
        box("Gap", (x, y1 - 0.512, 0.18), (x + 0.008, y1 - 0.50, 0.78), materials.paint("Gap", (0.01, 0.006, 0.004)))
    porcelain = materials.paint("Porcelain", (0.82, 0.80, 0.76), 0.25)
    suzanne("Bust", porcelain, (-0.72, y1 - 0.28, 1.08), 0.46, 12.0)
    base = [(0.0, 0.0), (0.12, 0.0), (0.12, 0.025), (0.05, 0.04), (0.045, 0.08), (0.0, 0.08)]
    turned("Base", base, porcelain).location = (-0.72, y1 - 0.27, 0.80)
    profile = [
        (0.0, 0.0), (0.055, 0.0), (0.10, 0.07), (0.125, 0.16), (0.10, 0.25), (0.05, 0.31), (0.045, 0.35), (0.065, 0.37),
        (0.055, 0.37), (0.036, 0.345), (0.04, 0.30), (0.09, 0.24), (0.11, 0.16), (0.0, 0.02),
    ]  # fmt: skip
    turned("Vase", profile, materials.glaze()).location = (-1.55, y1 - 0.27, 0.80)
    bowl = [(0.0, 0.0), (0.06, 0.0), (0.07, 0.015), (0.17, 0.09), (0.165, 0.095), (0.06, 0.03), (0.0, 0.025)]
    turned("Bowl", bowl, materials.metal("Copper", (0.86, 0.45, 0.27), 0.22)).location = (0.02, y1 - 0.27, 0.80)
    frame = (-1.48, y1 - 0.035, 1.46), (-0.02, y1 - 0.002, 2.32)
    box("Frame", *frame, materials.metal("Gilt", (0.72, 0.52, 0.24), 0.35), 0.006)
    box("Painting", (-1.42, y1 - 0.045, 1.52), (-0.08, y1 - 0.03, 2.26), materials.canvas())
    _books(random.Random(7), (-0.32, y1 - 0.28, 0.80), 4)


def _books(choose: random.Random, foot: tuple[float, float, float], count: int) -> None:
    """A pile of books, a colour each."""
    cover = materials.cloth_covers()
    height = foot[2]
    for _ in range(count):
        thickness = choose.uniform(0.025, 0.05)
        half = choose.uniform(0.10, 0.13), choose.uniform(0.075, 0.09)
        low, high = (-half[0], -half[1], 0.0), (half[0], half[1], thickness)
        book = box("Book", low, high, cover, 0.004, 2)
        book.location = (foot[0] + choose.uniform(-0.015, 0.015), foot[1], height + thickness / 2)
        book.rotation_euler.z = math.radians(choose.uniform(-14.0, 14.0))
        height += thickness


def _chair() -> None:
    """An armchair of cushions on wooden legs, on a rug, with a low table beside it."""
    oak = bpy.data.materials["Walnut"]
    green = materials.cloth("Green cloth", (0.07, 0.16, 0.13))
    parts = (
        ("Seat", (-0.36, -0.36, 0.26), (0.36, 0.36, 0.46)),
        ("Back", (-0.36, 0.24, 0.40), (0.36, 0.42, 1.00)),
        ("Arm left", (-0.48, -0.36, 0.22), (-0.33, 0.40, 0.64)),
        ("Arm right", (0.33, -0.36, 0.22), (0.48, 0.40, 0.64)),
    )
    root = add_object("Armchair", None)
    root.location, root.rotation_euler.z = (-1.62, 0.35, 0.0), math.radians(48.0)
    for name, low, high in parts:
        smooth(box(name, low, high, green, 0.07, 5)).parent = root
    for x in (-0.42, 0.36):
        for y in (-0.32, 0.32):
            box("Chair leg", (x, y, 0.0), (x + 0.06, y + 0.06, 0.23), oak, 0.006).parent = root
    ochre = materials.cloth("Ochre", (0.55, 0.27, 0.05))
    cushion = box("Cushion", (-0.20, -0.07, -0.20), (0.20, 0.07, 0.20), ochre, 0.065, 5)
    cushion.parent, cushion.location = root, (0.0, 0.14, 0.64)
    cushion.rotation_euler = (math.radians(-22.0), math.radians(8.0), 0.0)
    smooth(cushion)
    box("Rug", (-2.2, -1.3, 0.0), (0.9, 1.3, 0.012), materials.cloth("Rug", (0.36, 0.09, 0.06)), 0.005)
    box("Rug's field", (-2.05, -1.15, 0.002), (0.75, 1.15, 0.0135), materials.cloth("Rug's field", (0.50, 0.40, 0.29)))
    top = turned("Table", [(0.0, 0.0), (0.30, 0.0), (0.31, 0.02), (0.30, 0.035), (0.0, 0.035)], oak)
    top.location = (-0.38, 0.15, 0.46)
    foot = [(0.0, 0.0), (0.17, 0.0), (0.16, 0.02), (0.025, 0.04), (0.025, 0.46), (0.0, 0.46)]
    turned("Table's foot", foot, oak).location = (-0.38, 0.15, 0.0)
    cup = [(0.0, 0.0), (0.03, 0.0), (0.045, 0.07), (0.042, 0.07), (0.028, 0.006), (0.0, 0.006)]
    turned("Cup", cup, bpy.data.materials["Porcelain"]).location = (-0.30, 0.05, 0.495)
    _books(random.Random(3), (-0.46, 0.22, 0.495), 2)


def _plant() -> None:
    """A rubber plant in a pot, its leaves copies of one."""
    choose = random.Random(11)
    root = add_object("Plant", None)
    root.location = (0.80, 1.85, 0.0)
    pot = [(0.0, 0.0), (0.15, 0.0), (0.20, 0.34), (0.21, 0.34), (0.21, 0.36), (0.185, 0.36), (0.17, 0.31), (0.0, 0.31)]
    turned("Pot", pot, materials.paint("Terracotta", (0.50, 0.20, 0.10), 0.7)).parent = root
    stem = primitive(
        bpy.ops.mesh.primitive_cylinder_add, "Stem", materials.paint("Bark", (0.10, 0.06, 0.03), 0.8), radius=0.014,
        depth=1.1, vertices=12,
    )  # fmt: skip
    stem.parent, stem.location = root, (0.0, 0.0, 0.82)
    mesh = leaf("Leaf", 0.34, 0.17, materials.paint("Leaf", (0.03, 0.13, 0.035), 0.25))
    for k in range(26):
        item = add_object("Leaf", mesh)
        item.parent, item.location = root, (0.0, 0.0, 0.48 + 0.034 * k)
        lift = math.radians(choose.uniform(18.0, 42.0) + 1.2 * k)
        item.rotation_euler = (choose.uniform(-0.2, 0.2), -lift, 2.4 * k + choose.uniform(-0.3, 0.3))
        size = choose.uniform(0.8, 1.1) * (1.0 - 0.014 * k)
        item.scale = (size, size, size)


def _camera() -> None:
    data = bpy.data.cameras.new("Camera")
    data.lens = 30.0
    camera = add_object("Camera", data)
    camera.location = (0.12, -3.1, 1.38)
    camera.rotation_euler = (math.radians(85.5), 0.0, math.radians(1.0))
    bpy.context.scene.camera = camera


def build(width: int = 640, height: int = 360, samples: int = 4096) -> bpy.types.Scene:
    """Replace the open file by the study, ready to render with NEURALGUIDE, which must be registered."""
    bpy.ops.wm.read_homefile(use_empty=True, use_factory_startup=True)
    scene = bpy.context.scene
    scene.world = bpy.data.worlds.new("Night")
    scene.world.color = (0.0, 0.0, 0.0)
    _shell()
    _lamps()
    _console()
    _chair()
    _plant()
    _camera()
    set_up(scene, (width, height), samples, bounces=16, clamp_indirect=0.0, exposure=1.0)
    return scene
