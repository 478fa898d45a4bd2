# SPDX-License-Identifier: GPL-3.0-or-later
"""Surfaces that their materials displace."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    camera,
    diffuse,
    light,
    lit_stage,
    mesh,
    quad,
    resolution,
    sphere,
    world,
)


def displaced(
    offset: Callable[[Nodes], Socket], method: str = "DISPLACEMENT", color: Any = (0.6, 0.5, 0.4), surface: Any = None
) -> Any:
    """A material that moves its surface by what `offset(nodes)` returns."""
    created = bpy.data.materials.new(method.lower())
    if created.node_tree is None:
        created.use_nodes = True
    nodes = Nodes(created.node_tree)
    shown = nodes("BsdfDiffuse", Color=color) if surface is None else surface(nodes)
    nodes.node("OutputMaterial", Surface=shown, Displacement=offset(nodes))
    created.displacement_method = method
    return created


def grid(name: str, surface: Any, size: float, count: int, is_smooth: bool = True) -> Any:
    """A square of `count` by `count` faces in the xy plane, with a UV map."""
    steps = np.linspace(-0.5, 0.5, count + 1)
    vertices = [(size * x, size * y, 0.0) for y in steps for x in steps]
    corners = [(0, 0), (1, 0), (1, 1), (0, 1)]
    faces = [
        tuple((row + y) * (count + 1) + column + x for x, y in corners)
        for row in range(count) for column in range(count)
    ]  # fmt: skip
    uvs = [(vertices[v][0] / size + 0.5, vertices[v][1] / size + 0.5) for face in faces for v in face]
    created = mesh(name, vertices, faces, surface, uvs)
    created.polygons.foreach_set("use_smooth", np.full(len(faces), is_smooth))
    return created


def noise(nodes: Nodes, coordinate: str, scale: float, detail: float = 0.0) -> Socket:
    """A noise between 0 and 1 by a kind of texture coordinates."""
    return nodes("TexNoise", Vector=nodes("TexCoord", output=coordinate), Scale=scale, Detail=detail)


def _sunlit(look_from: tuple[float, float, float]) -> None:
    resolution()
    camera(look_from, (0.0, 0.0, 0.2))
    world((0.2, 0.25, 0.35))
    light("SUN", 3.0, (3.0, -1.0, 2.5), angle=0.05)


@scene("displaced-planet")
def planet() -> None:
    """A sphere with mountains by generated coordinates, of which the material shows where they were."""
    _sunlit((0.0, -4.0, 1.0))

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Generated", 5.0, 2.0), Midlevel=0.5, Scale=0.6)

    def surface(nodes: Nodes) -> Socket:
        return nodes("BsdfDiffuse", Color=nodes("TexCoord", output="Generated"))

    data = sphere("Planet", displaced(heights, surface=surface), 1.0, segments=128, rings=64)
    add_object("Planet", data, rotation=(20, 0, 30))


@scene("displaced-cliff")
def cliff() -> None:
    """A plane that hangs over by vector displacement: in tangent space, in object space and in the world's."""
    _sunlit((0.5, -4.5, 2.0))
    offsets = {"TANGENT": (0.5, 0.6, 0.0), "OBJECT": (0.4, -0.2, 0.5), "WORLD": (-0.4, 0.0, 0.5)}
    for column, (space, most) in enumerate(offsets.items()):

        def vector(nodes: Nodes, space: str = space, most: tuple[float, ...] = most) -> Socket:
            wave = nodes("TexWave", {"bands_direction": "X"}, Vector=nodes("TexCoord", output="UV"), Scale=0.35)
            along = nodes("VectorMath", {"operation": "MULTIPLY"}, inputs={0: wave, 1: most})
            return nodes("VectorDisplacement", {"space": space}, Vector=along, Midlevel=0.1, Scale=1.0)

        data = grid(f"Cliff {space}", displaced(vector), 1.2, 60)
        add_object(f"Cliff {space}", data, (1.5 * (column - 1), 0.0, 0.0), (20, 10, 25 * column))


@scene("displaced-both")
def both() -> None:
    """Coarse meshes that are displaced, and bumped by what is finer: by each kind of coordinates, and flat."""
    _sunlit((0.0, -4.5, 2.5))
    for column, (coordinate, scale) in enumerate({"Generated": 6.0, "Object": 4.0, "UV": 6.0}.items()):

        def heights(nodes: Nodes, coordinate: str = coordinate, scale: float = scale) -> Socket:
            return nodes("Displacement", Height=noise(nodes, coordinate, scale, 3.0), Midlevel=0.5, Scale=0.5)

        data = grid(f"Both {coordinate}", displaced(heights, "BOTH"), 1.3, 24, is_smooth=column != 2)
        add_object(f"Both {coordinate}", data, (1.5 * (column - 1), 0.0, 0.0), (15, 0, 20))
    round_one = sphere("Round", displaced(lambda nodes: nodes(
        "Displacement", Height=noise(nodes, "Generated", 8.0, 3.0), Midlevel=0.5, Scale=0.3
    ), "BOTH"), 0.6, segments=32, rings=16)  # fmt: skip
    add_object("Round", round_one, (0.0, 1.2, 0.9))


@scene("displaced-instances")
def instances() -> None:
    """One flat mesh that several objects share: turned, stretched, mirrored, and one that only bumps it."""
    lit_stage()

    def heights(nodes: Nodes) -> Socket:
        return nodes("Displacement", Height=noise(nodes, "Object", 3.0), Midlevel=0.4, Scale=0.6)

    data = grid("Ground", displaced(heights), 1.2, 12, is_smooth=False)
    for name, place, turn, size in (
        ("First", (-1.5, 0.0, 0.6), (30, 0, 0), (1.0, 1.0, 1.0)),
        ("Stretched", (0.0, 0.0, 0.6), (30, 0, 40), (1.0, 1.6, 0.7)),
        ("Mirrored", (1.5, 0.0, 0.6), (30, 0, 0), (-1.0, 1.0, 1.0)),
    ):
        add_object(name, data, place, turn).scale = size
    plain = add_object("Plain", data, (0.0, 1.6, 1.0), (60, 0, 0))
    plain.material_slots[0].link = "OBJECT"
    plain.material_slots[0].material = diffuse((0.3, 0.5, 0.6))


@scene("displaced-dunes")
def dunes() -> None:
    """A single face, diced by half the size of a pixel, with dunes."""
    resolution()
    camera((0.0, -6.0, 2.6), (0.0, 0.0, 0.2))
    world((0.3, 0.4, 0.6))
    light("SUN", 3.0, (3.0, 1.0, 1.5), angle=0.05)

    def heights(nodes: Nodes) -> Socket:
        place = nodes("TexCoord", output="Object")
        wave = nodes("TexWave", {"bands_direction": "Y"}, Vector=place, Scale=0.4, Distortion=4.0, Detail=0.0)
        high = nodes("Math", {"operation": "MULTIPLY"}, inputs={0: noise(nodes, "Object", 0.2), 1: 1.5})
        both = nodes("Math", {"operation": "ADD"}, inputs={0: wave, 1: high})
        return nodes("Displacement", Height=both, Midlevel=1.0, Scale=0.3)

    data = quad("Dunes", displaced(heights, color=(0.8, 0.6, 0.35)), 24.0, 24.0)
    modifier = add_object("Dunes", data, (0.0, 5.0, 0.0)).modifiers.new("Subdivision", "SUBSURF")
    modifier.subdivision_type, modifier.render_levels = "SIMPLE", 11
    if hasattr(modifier, "use_adaptive_subdivision"):
        modifier.use_adaptive_subdivision, modifier.adaptive_pixel_size = True, 0.5
    else:
        modifier.render_levels = 8
