# SPDX-License-Identifier: GPL-3.0-or-later
"""Dispersion: what comes apart into colours, and what must keep its colour when light has wavelengths.

Cycles renders these scenes as if glass had one refractive index, that of the nodes.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    aim,
    box,
    camera,
    diffuse,
    emitter,
    light,
    material,
    mesh,
    quad,
    resolution,
    sphere,
    stage,
    world,
    world_nodes,
)

#: Dense flint (SF10): index at 587.6 nm, and Abbe number.
FLINT = (1.7283, 28.4)
WATER = (1.3330, 55.7)
#: Angle between the prism's faces [degrees].
PRISM_ANGLE = 60.0
#: From the prism's faces to the slit and to the camera [m], the slit's width [m], and the camera's lens [mm].
PRISM_LENS = 200.0
SLIT_DISTANCE, PRISM_CAMERA_DISTANCE, SLIT_WIDTH = 12.0, 4.0, 0.06
#: Angle of the ring before a ball of water from the line of sight, and its width [degrees].
RING, RING_WIDTH = 41.6, 0.4


def _dispersive(name: str, index_and_abbe: tuple[float, float], color: Sequence[float] = (1.0, 1.0, 1.0)) -> Any:
    """Smooth glass with an Abbe number."""
    import addon

    addon.register()
    ior, abbe_number = index_and_abbe
    glass = material(name, lambda nodes: nodes("BsdfGlass", Color=color, Roughness=0.0, IOR=ior))
    glass.neuralguide.dispersion = "ABBE"
    glass.neuralguide.abbe_number = abbe_number
    return glass


def _bounces(count: int = 16) -> None:
    import bpy

    cycles = bpy.context.scene.cycles
    cycles.max_bounces = cycles.glossy_bounces = cycles.transmission_bounces = count


def least_deviation(ior: float, angle: float = PRISM_ANGLE) -> float:
    """By how much a prism turns light that passes it symmetrically [degrees]."""
    return 2.0 * math.degrees(math.asin(ior * math.sin(math.radians(0.5 * angle)))) - angle


def rainbow_angle(ior: float) -> float:
    """Angle of the primary bow from the antisolar point [degrees] (Descartes): the least deviation of a drop."""
    incidence = math.acos(math.sqrt((ior * ior - 1.0) / 3.0))
    return math.degrees(4.0 * math.asin(math.sin(incidence) / ior) - 2.0 * incidence)


def _prism(surface: Any, side: float, height: float, base: Any = None) -> Any:
    """A prism about the z axis, its edge towards +y, the face towards -y of the material `base` if there is one."""
    corners = [(side / math.sqrt(3.0) * math.cos(math.radians(a)), side / math.sqrt(3.0) * math.sin(math.radians(a)))
               for a in (90.0, 210.0, 330.0)]  # fmt: skip
    vertices = [(x, y, z) for z in (-height / 2, height / 2) for x, y in corners]
    created = mesh("Prism", vertices, [(2, 1, 0), (3, 4, 5), (0, 1, 4, 3), (1, 2, 5, 4), (2, 0, 3, 5)], surface)
    if base is not None:
        created.materials.append(base)
        created.polygons[3].material_index = 1
    return created


@scene("spectral-prism")
def prism() -> None:
    """A bright slit seen through a prism at least deviation, which spreads it into a spectrum."""
    resolution()
    _bounces()
    world((0.01, 0.01, 0.01))
    half = math.radians(0.5 * least_deviation(FLINT[0]))
    # The base is black: light that it reflects leaves as white as it came.
    add_object("Prism", _prism(_dispersive("flint", FLINT), 2.0, 3.0, diffuse((0.0, 0.0, 0.0), "black")))
    slit = quad("Slit", emitter((1.0, 1.0, 1.0), 40.0), SLIT_WIDTH, 1.2)
    # The ray in the middle of the picture crosses the prism along the x axis, and so the faces at these places.
    face = 2.0 / (2.0 * math.sqrt(3.0)) / math.cos(math.radians(0.5 * PRISM_ANGLE))
    made = add_object("Slit", slit, (-face - SLIT_DISTANCE * math.cos(half), -SLIT_DISTANCE * math.sin(half), 0.0))
    # The quad's +z towards the prism, its y upwards.
    made.rotation_euler = (0.5 * math.pi, 0.0, 0.5 * math.pi + half)
    there = (face + PRISM_CAMERA_DISTANCE * math.cos(half), -PRISM_CAMERA_DISTANCE * math.sin(half), 0.0)
    camera(there, (face, 0.0, 0.0), lens=PRISM_LENS)


@scene("spectral-sphere", samples=128)
def rainbow() -> None:
    """A ball of water before a sky that glows in a thin ring about the viewer, where a rainbow is yellow.

    A drop of a rainbow, its sun drawn into a ring: light that was reflected once inside comes from it to the viewer up
    to 42.4 degrees if it is red, up to 40.7 degrees if it is violet. What the ball reflects outside has no colour.
    """
    resolution(96, 96)
    _bounces()
    ring, width = math.radians(RING), math.radians(RING_WIDTH)
    compare = math.cos(ring), math.sin(ring) * 0.5 * width

    def surface(nodes: Nodes) -> Socket:
        where = nodes("TexCoord", output="Generated")
        back = nodes("VectorMath", {"operation": "DOT_PRODUCT"}, {0: where, 1: (0.0, -1.0, 0.0)}, output="Value")
        glows = nodes("Math", {"operation": "COMPARE"}, {0: back, 1: compare[0], 2: compare[1]})
        strength = nodes("Math", {"operation": "MULTIPLY"}, {0: glows, 1: 20.0})
        return nodes("Background", Color=(1.0, 1.0, 1.0), Strength=strength)

    world_nodes(surface)
    add_object("Ball", sphere("Ball", _dispersive("water", WATER), 1.0, 256, 128))
    view = camera((0.0, -10.0, 0.0), (0.0, 0.0, 0.0))
    view.data.type, view.data.ortho_scale = "ORTHO", 2.2


@scene("spectral-glass", samples=256)
def glass() -> None:
    """A ball, a prism and a cut stone of strongly dispersive glass on the stage, under a small bright lamp."""
    import bmesh
    import bpy

    stage((0.7, 0.7, 0.7))
    _bounces()
    world((0.1, 0.1, 0.1))
    add_object("Ball", sphere("Ball", _dispersive("flint", FLINT), 0.6), (-1.1, -0.2, 0.6))
    add_object("Prism", _prism(_dispersive("prism", (1.7847, 25.7)), 1.1, 1.2), (0.2, 0.5, 0.61), (0, 0, 20))
    stone = bmesh.new()
    bmesh.ops.create_icosphere(stone, subdivisions=2, radius=0.5)
    cut = bpy.data.meshes.new("Stone")
    stone.to_mesh(cut)
    stone.free()
    cut.materials.append(_dispersive("stone", (2.417, 20.0)))
    add_object("Stone", cut, (1.1, -0.6, 0.45))
    light("AREA", 250.0, (2.5, -2.0, 4.5), size=0.8)


@scene("spectral-panes", samples=512)
def panes() -> None:
    """A room whose coloured lamps are behind bevelled panes of flint glass: all light has come through them."""
    resolution()
    _bounces()
    wall, x, y, z = diffuse((0.75, 0.75, 0.75), "wall"), 2.5, 3.0, 2.6
    add_object("Floor", quad("Floor", wall, 2 * x, 2 * y))
    add_object("Ceiling", quad("Ceiling", wall, 2 * x, 2 * y), (0, 0, z), (180, 0, 0))
    add_object("Back", quad("Back", wall, 2 * x, z), (0, y, z / 2), (90, 0, 0))
    add_object("Front", quad("Front", wall, 2 * x, z), (0, -y, z / 2), (-90, 0, 0))
    add_object("Right", quad("Right", wall, z, 2 * y), (x, 0, z / 2), (0, -90, 0))
    # The left wall has three windows from 0.7 to 1.9 m.
    for low, high in ((0.0, 0.7), (1.9, z)):
        add_object("Left", quad("Left", wall, high - low, 2 * y), (-x, 0, (low + high) / 2), (0, 90, 0))
    edges = (-y, -1.9, -0.9, -0.5, 0.5, 0.9, 1.9, y)
    for low, high in zip(edges[::2], edges[1::2], strict=True):
        add_object("Left", quad("Left", wall, 1.2, high - low), (-x, (low + high) / 2, 1.3), (0, 90, 0))
    flint = _dispersive("flint", FLINT)
    colors = ((1.0, 0.25, 0.1), (0.9, 0.9, 0.8), (0.15, 0.3, 1.0))
    for middle, color, tilt in zip((-1.4, 0.0, 1.4), colors, (25, -20, 15), strict=True):
        shaft = box("Shaft", diffuse((0.02, 0.02, 0.02), "shaft"), (1.6, 0.05, 1.3))
        for side in (-0.53, 0.53):
            add_object("Shaft", shaft, (-x - 0.85, middle + side, 1.3))
        lid = box("Lid", diffuse((0.02, 0.02, 0.02), "shaft"), (1.6, 1.1, 0.05))
        for height in (0.675, 1.925):
            add_object("Lid", lid, (-x - 0.85, middle, height))
        pane = _prism(flint, 1.15, 1.15)
        add_object("Pane", pane, (-x - 0.5, middle, 1.3), (0, 0, 90 + tilt))
        add_object("Lamp", quad("Lamp", emitter(color, 60.0), 1.1, 0.9), (-x - 1.6, middle, 1.3), (0, 90, 0))
    add_object("Table", box("Table", diffuse((0.6, 0.45, 0.3), "table"), (1.2, 1.8, 0.1)), (0.6, 0.2, 0.75))
    add_object("Vase", sphere("Vase", diffuse((0.8, 0.8, 0.8), "vase"), 0.3), (0.6, 0.2, 1.1))
    camera((1.9, -2.7, 1.5), (-0.5, 0.6, 1.0), lens=24.0)


@scene("spectral-lanterns", samples=512)
def lanterns() -> None:
    """Small lamps inside balls of coloured dispersive glass, the only light of a dark yard."""
    stage((0.5, 0.5, 0.5), with_camera=False)
    camera((0.0, -5.0, 2.6), (0.0, 0.0, 0.5))
    _bounces()
    places = ((-1.2, -0.2, 0.55), (0.0, 0.7, 0.55), (1.1, -0.5, 0.55))
    colors = ((1.0, 0.75, 0.35), (0.5, 1.0, 0.7), (0.6, 0.65, 1.0))
    for place, color in zip(places, colors, strict=True):
        thick = _dispersive("lantern", FLINT, color)
        add_object("Lantern", sphere("Lantern", thick, 0.5), place)
        inside = sphere("Hollow", thick, 0.3)
        inside.flip_normals()
        add_object("Hollow", inside, place)
        add_object("Lamp", sphere("Lamp", emitter((1.0, 1.0, 1.0), 40.0), 0.15, 24, 12), place)


def _checked(first: Sequence[float], second: Sequence[float]) -> Any:
    def surface(nodes: Nodes) -> Socket:
        where = nodes("TexCoord", output="Object")
        colors = {"Color1": (*first, 1.0), "Color2": (*second, 1.0)}
        return nodes("BsdfDiffuse", Color=nodes("TexChecker", Vector=where, Scale=5.0, inputs=colors))

    return material("checked", surface)


@scene("spectral-colors")
def colors() -> None:
    """Saturated, pale and checked boxes and lamps of two colours, and nothing that disperses: the RGB picture."""
    resolution()
    world((0.3, 0.33, 0.4))
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6), "floor"), 12.0, 12.0))
    saturated = (
        (0.9, 0.02, 0.02), (0.02, 0.7, 0.03), (0.03, 0.05, 0.9), (0.9, 0.8, 0.01), (0.01, 0.7, 0.8), (0.8, 0.02, 0.7)
    )  # fmt: skip
    pale = (
        (0.9, 0.6, 0.55), (0.65, 0.85, 0.6), (0.6, 0.65, 0.9), (0.9, 0.85, 0.6), (0.18, 0.12, 0.09), (0.04, 0.05, 0.07)
    )  # fmt: skip
    for index, (strong, weak) in enumerate(zip(saturated, pale, strict=True)):
        x = 0.8 * (index - 2.5)
        add_object("Strong", box("Strong", diffuse(strong, "strong"), (0.55, 0.55, 0.55)), (x, 0.6, 0.3), (0, 0, 20))
        add_object("Weak", box("Weak", diffuse(weak, "weak"), (0.55, 0.55, 0.55)), (x, -0.3, 0.3), (0, 0, -15))
        mixed = _checked(strong, weak)
        add_object("Ball", sphere("Ball", mixed, 0.27), (x, -1.1, 0.27))
    light("AREA", 150.0, (2.5, -2.0, 4.0), size=2.0, color=(1.0, 0.7, 0.4))
    lamp = light("AREA", 60.0, (-3.0, -1.0, 3.0), size=1.0, color=(0.3, 0.5, 1.0))
    aim(lamp, (0.0, 0.0, 0.3))
    camera((0.0, -5.5, 2.8), (0.0, -0.2, 0.3), lens=40.0)
