# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes with one quantity to turn up, for `scaling` and `scale`; the built-in ones have no parameters."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.studio import (
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    diffuse,
    emitter,
    image,
    light,
    lit_stage,
    material,
    quad,
    resolution,
    show,
    sphere,
    world,
)

_TERRAIN_SIZE = 10.0


def _empty() -> None:
    bpy.ops.wm.read_homefile(use_empty=True)


def _triangle_mesh(name: str, vertices: np.ndarray, triangles: np.ndarray, surface: Any) -> Any:
    """A mesh from arrays (V, 3) and (T, 3), fast for millions."""
    created = bpy.data.meshes.new(name)
    created.vertices.add(len(vertices))
    created.vertices.foreach_set("co", np.ascontiguousarray(vertices, np.float32).ravel())
    created.loops.add(triangles.size)
    created.loops.foreach_set("vertex_index", np.ascontiguousarray(triangles, np.int32).ravel())
    created.polygons.add(len(triangles))
    created.polygons.foreach_set("loop_start", np.arange(0, triangles.size, 3, dtype=np.int32))
    created.materials.append(surface)
    created.update(calc_edges=True)
    return created


def stage() -> None:
    """The stage of the small scenes, as it is."""
    _empty()
    lit_stage()
    show(diffuse((0.7, 0.6, 0.5)))


def terrain(triangle_count: int) -> int:
    """Hills of about so many triangles under a soft sky; returns how many there are.

    The hills are the same whatever the count: only how finely they are cut differs.
    """
    _empty()
    resolution()
    cells = max(round((triangle_count / 2) ** 0.5), 2)
    line = np.linspace(-0.5, 0.5, cells + 1)
    x, y = (axis.ravel() for axis in np.meshgrid(line, line))
    height = sum(np.sin(k * 9.0 * x + k) * np.cos(k * 7.0 * y - k) / k**1.5 for k in (1, 2, 3, 5, 8, 13))
    vertices = np.stack([_TERRAIN_SIZE * x, _TERRAIN_SIZE * y, 0.25 * height], axis=1)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    lower = np.stack([corner, corner + 1, corner + cells + 2], axis=1)
    upper = np.stack([corner, corner + cells + 2, corner + cells + 1], axis=1)
    mesh = _triangle_mesh("Hills", vertices, np.concatenate([lower, upper]), diffuse((0.6, 0.6, 0.6)))
    add_object("Hills", mesh)
    world((0.5, 0.6, 0.7))
    camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.0))
    return 2 * cells * cells


def lamps(light_count: int) -> None:
    """So many small glowing triangles above the stage's floor, of the same light together."""
    _empty()
    resolution()
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6)), 12.0, 12.0))
    show(diffuse((0.7, 0.6, 0.5)))
    generator = np.random.default_rng(11)
    centres = generator.uniform((-4.0, -2.0, 0.3), (4.0, 4.0, 3.5), (light_count, 3))
    corners = centres[:, None, :] + generator.normal(0.0, 0.02, (light_count, 3, 3))
    triangles = np.arange(3 * light_count).reshape(-1, 3)
    glow = emitter((1.0, 0.8, 0.6), 20_000.0 / light_count)
    add_object("Lamps", _triangle_mesh("Lamps", corners.reshape(-1, 3), triangles, glow))
    world((0.0, 0.0, 0.0))
    camera()


def instances(count: int) -> None:
    """So many instances of one ball, in a square field under a soft sky."""
    _empty()
    resolution()
    side = math.ceil(count**0.5)
    step = _TERRAIN_SIZE / side
    at = np.arange(count)
    places = np.stack([at % side - (side - 1) / 2, at // side - (side - 1) / 2, np.zeros(count)], axis=1) * step
    _scatter(add_object("Ball", sphere("Ball", diffuse((0.7, 0.6, 0.5)), 0.4 * step)), places)
    world((0.5, 0.6, 0.7))
    camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.0))


def _scatter(thing: Any, places: np.ndarray) -> None:
    """Have an object appear at each of these places (N, 3), and there alone."""
    field = bpy.data.meshes.new("Field")
    field.vertices.add(len(places))
    field.vertices.foreach_set("co", places.astype(np.float32).ravel())
    thing.parent = add_object("Field", field)
    thing.parent.instance_type = "VERTS"


def light_objects(count: int) -> None:
    """So many small point lights above a floor, instances of one, of the same light together."""
    _empty()
    resolution()
    add_object("Floor", quad("Floor", diffuse((0.6, 0.6, 0.6)), 12.0, 12.0))
    show(diffuse((0.7, 0.6, 0.5)))
    bulb = bpy.data.lights.new("Bulb", "POINT")
    bulb.energy, bulb.shadow_soft_size = 1000.0 / count, 0.01
    generator = np.random.default_rng(12)
    _scatter(add_object("Bulb", bulb), generator.uniform((-4.0, -2.0, 0.3), (4.0, 4.0, 3.5), (count, 3)))
    camera()
    world((0.0, 0.0, 0.0))


def textures(count: int, folder: Path, size: int = 4096) -> None:
    """So many boards, each with an image of its own, of `size` x `size` pixels in a file in `folder`.

    The files are one under many names: nobody who loads them can know.
    """
    _empty()
    resolution()
    first = folder / f"{size}.png"
    if not first.exists():
        ramp = np.linspace(0.05, 0.95, size, dtype=np.float32)
        stripes = np.where(np.arange(size) // 16 % 2, np.float32(0.3), np.float32(0.8))
        pixels = np.ones((size, size, 4), np.float32)
        pixels[..., 0], pixels[..., 1], pixels[..., 2] = ramp, ramp[:, None], stripes
        made = image("Painted", pixels)
        made.filepath_raw, made.file_format = str(first), "PNG"
        made.save()
        bpy.data.images.remove(made)
    side = math.ceil(count**0.5)
    step = 4.0 / side
    for number in range(count):
        path = folder / f"{size}-{number}.png"
        if not path.exists():
            path.hardlink_to(first)

        def painted(nodes: Nodes, path: Path = path) -> Socket:
            loaded = bpy.data.images.load(str(path), check_existing=False)
            return nodes("BsdfDiffuse", Color=nodes("TexImage", {"image": loaded}))

        board = quad(f"Board {number}", material(f"board {number}", painted), 0.95 * step, 0.95 * step)
        place = (number % side - (side - 1) / 2) * step, (number // side - (side - 1) / 2) * step, 0.0
        add_object(f"Board {number}", board, place)
    world((1.0, 1.0, 1.0))
    camera((0.0, -0.01, 5.6), (0.0, 0.0, 0.0))


#: Points along a strand of 8 steps.
_KEYS = 9


def strands(count: int) -> None:
    """A Curves object of so many strands of 8 steps, on a square field under a soft sky."""
    _empty()
    resolution()
    generator = np.random.default_rng(13)
    data = bpy.data.hair_curves.new("Strands")
    data.add_curves([_KEYS] * count)
    places = np.zeros((count, _KEYS, 3), np.float32)
    places[...] = generator.uniform(-0.5, 0.5, (count, 1, 3)) * (_TERRAIN_SIZE, _TERRAIN_SIZE, 0.0)
    steps = np.linspace(0.0, 1.0, _KEYS)[:, None]
    places += steps * (0.0, 0.0, 0.4) + steps**2 * generator.normal(0.0, 0.1, (count, 1, 3))
    data.position_data.foreach_set("vector", places.ravel())
    thin = np.tile(np.linspace(2.0, 0.5, _KEYS), count) / count**0.5
    data.attributes.new("radius", "FLOAT", "POINT").data.foreach_set("value", thin.astype(np.float32))
    data.materials.append(diffuse((0.7, 0.6, 0.5)))
    add_object("Strands", data)
    world((0.5, 0.6, 0.7))
    camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.0))


def hair(count: int) -> None:
    """About so many hairs of 8 steps that particles grow on a ball, children of a hundredth as many."""
    _empty()
    resolution()
    ball = add_object("Ball", sphere("Ball", diffuse((0.7, 0.6, 0.5)), 1.5))
    settings = ball.modifiers.new("Fur", "PARTICLE_SYSTEM").particle_system.settings
    settings.type, settings.hair_length, settings.render_step = "HAIR", 0.4, 3
    settings.count, settings.child_type, settings.rendered_child_count = max(count // 100, 1), "INTERPOLATED", 100
    settings.radius_scale, settings.root_radius, settings.tip_radius = 2.0 / count**0.5, 1.0, 0.2
    world((0.5, 0.6, 0.7))
    camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.0))


def points(count: int) -> None:
    """A cloud of so many points under a soft sky."""
    _empty()
    resolution()
    generator = np.random.default_rng(14)
    field = bpy.data.meshes.new("Points")
    field.vertices.add(count)
    places = generator.uniform(-0.5, 0.5, (count, 3)) * (_TERRAIN_SIZE, _TERRAIN_SIZE, 1.0)
    field.vertices.foreach_set("co", places.astype(np.float32).ravel())
    made = add_object("Points", field)
    field.materials.append(diffuse((0.7, 0.6, 0.5)))
    group = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    group.interface.new_socket("Geometry", in_out="INPUT", socket_type="NodeSocketGeometry")
    group.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    given, left = group.nodes.new("NodeGroupInput"), group.nodes.new("NodeGroupOutput")
    turned = group.nodes.new("GeometryNodeMeshToPoints")
    turned.inputs["Radius"].default_value = 3.0 / count**0.5
    shaded = group.nodes.new("GeometryNodeSetMaterial")
    shaded.inputs["Material"].default_value = field.materials[0]
    group.links.new(given.outputs[0], turned.inputs[0])
    group.links.new(turned.outputs[0], shaded.inputs[0])
    group.links.new(shaded.outputs[0], left.inputs[0])
    made.modifiers.new("Points", "NODES").node_group = group
    world((0.5, 0.6, 0.7))
    camera((0.0, -6.0, 3.0), (0.0, 0.0, 0.0))


def closed_box() -> None:
    """A light room without a way out, in which paths go on as long as they may."""
    _empty()
    resolution()
    add_object("Room", box("Room", diffuse((0.85, 0.85, 0.85)), (6.0, 6.0, 4.0)), (0.0, 0.0, 2.0))
    add_object("Table", box("Table", diffuse((0.8, 0.7, 0.6)), (1.5, 1.0, 0.8)), (0.0, 1.0, 0.4))
    light("AREA", 100.0, (0.0, 0.0, 3.9), (0.0, 0.0, 0.0), size=1.0)
    world((0.0, 0.0, 0.0))
    camera((0.0, -2.6, 1.8), (0.0, 1.0, 0.8), 24.0)
