# SPDX-License-Identifier: GPL-3.0-or-later
"""Heads, rugs, statues and busts: what hair, light below surfaces and points are for. Sizes are those of a test."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from benchmarks.scenes.interiors.shapes import turned
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import (
    ORIGIN,
    Nodes,
    Socket,
    add_object,
    box,
    camera,
    light,
    lit_stage,
    material,
    mesh,
    quad,
    stage,
    world,
)

#: How far red, green and blue go in skin, over the farthest.
_SKIN = (1.0, 0.35, 0.2)
#: Hairs of a system that Blender grows; the others are children between them.
_GUIDES = 400


def fibre(nodes: Nodes, melanin: float = 0.5) -> Socket:
    """Chiang's hair, each strand of a colour of its own."""
    settings = {"model": "CHIANG", "parametrization": "MELANIN"}
    return nodes("BsdfHairPrincipled", settings, Melanin=melanin, Roughness=0.3, Random_Color=0.3)


def skin(nodes: Nodes) -> Socket:
    """Skin below a dielectric."""
    return nodes(
        "BsdfPrincipled", {"subsurface_method": "RANDOM_WALK_SKIN"}, Base_Color=(0.8, 0.5, 0.4), Roughness=0.4,
        Subsurface_Weight=1.0, Subsurface_Radius=_SKIN, Subsurface_Scale=0.12, Subsurface_Anisotropy=0.8,
    )  # fmt: skip


def marble(nodes: Nodes) -> Socket:
    """Polished stone with veins, into which light goes a little."""
    place = nodes("TexCoord", output="Object")
    veins = nodes("TexWave", Vector=place, Scale=1.2, Distortion=9.0, Detail=3.0, output="Fac")
    thin = nodes("Math", {"operation": "POWER"}, inputs={0: veins, 1: 0.2})
    color = nodes("Mix", {"data_type": "RGBA"}, {
        "Factor_Float": thin, "A_Color": (0.25, 0.27, 0.3), "B_Color": (0.9, 0.88, 0.85),
    }, output=2)  # fmt: skip
    return nodes(
        "BsdfPrincipled", {"subsurface_method": "RANDOM_WALK"}, Base_Color=color, Roughness=0.15,
        Subsurface_Weight=1.0, Subsurface_Radius=(1.0, 0.9, 0.8), Subsurface_Scale=0.08,
    )  # fmt: skip


def milk(nodes: Nodes) -> Socket:
    """Milk, as if it stood without a glass."""
    return nodes(
        "SubsurfaceScattering", {"falloff": "RANDOM_WALK"}, Color=(0.95, 0.92, 0.85), Radius=(1.0, 0.8, 0.6), Scale=0.25
    )


def suzanne(surface: Any, location: Any, size: float = 1.6, turn: float = 0.0, levels: int = 1) -> Any:
    """Blender's monkey, smooth, turned by so many degrees."""
    bpy.ops.mesh.primitive_monkey_add(size=size, location=location, rotation=(0.0, 0.0, np.radians(turn)))
    item = bpy.context.object
    item.data.polygons.foreach_set("use_smooth", [True] * len(item.data.polygons))
    item.data.materials.append(surface)
    modifier = item.modifiers.new("Subdivision", "SUBSURF")
    modifier.levels = modifier.render_levels = levels
    return item


def grow(
    item: Any, strands: int, length: float, radius: float, surface: Any, comb: Any = ORIGIN, **settings: Any
) -> Any:
    """Hair on an object, its system of particles.

    Parameters
    ----------
    strands : int
        About how many.
    length, radius : float
        Along normals, and at roots [m].
    comb : (3,)
        What is added to `length` times the normal, in object space [m].
    """
    item.data.materials.append(surface)
    system = item.modifiers.new("Hair", "PARTICLE_SYSTEM").particle_system
    hair = system.settings
    hair.type, hair.count = "HAIR", min(_GUIDES, strands)
    hair.use_advanced_hair, hair.render_step = True, 4
    # Hair is where a particle would go in four units of time.
    hair.normal_factor, hair.object_align_factor = length / 4.0, [offset / 4.0 for offset in comb]
    hair.child_type, hair.rendered_child_count = "INTERPOLATED", max(strands // _GUIDES, 1)
    hair.radius_scale, hair.root_radius, hair.tip_radius = radius, 1.0, 0.3
    hair.material = len(item.data.materials)
    for name, value in settings.items():
        setattr(hair, name, value)
    return system


def haired_head(strands: int, thickness: float, location: Any = (0.0, 0.0, 1.0), turn: float = 20.0) -> None:
    """A head with skin, and with hair that stands up where a scalp is."""
    head = suzanne(material("Skin", skin), location, 1.7, turn)
    x, y, z = np.array([vertex.co for vertex in head.data.vertices]).T / 0.85
    scalp = (np.abs(x) < 0.85) & (((z > 0.35) & (y > -0.35)) | ((y > 0.1) & (z > -0.1)))
    head.vertex_groups.new(name="Scalp").add(np.flatnonzero(scalp).tolist(), 1.0, "REPLACE")
    system = grow(
        head, strands, 0.3, thickness, material("Hair", fibre), (0.0, 0.1, 0.15),
        clump_factor=0.4, kink="CURL", kink_amplitude=0.03, length_random=0.3,
    )  # fmt: skip
    system.vertex_group_density = "Scalp"


def rug(strands: int, thickness: float, size: tuple[float, float] = (3.2, 2.4)) -> None:
    """A rug of wool, a hand high, that bends to one side."""
    item = add_object("Rug", quad("Rug", material("Weave", lambda nodes: nodes("BsdfDiffuse")), *size), (0, 0, 0.01))
    grow(
        item, strands, 0.2, thickness, material("Wool", lambda nodes: fibre(nodes, 0.15)), (0.08, 0.02, 0.0),
        brownian_factor=0.02, clump_factor=0.6, kink="WAVE", kink_amplitude=0.04,
    )  # fmt: skip


def blinds(place: tuple[float, float, float], count: int = 7) -> None:
    """Slats of blinds, half open, one over the other."""
    slat = box("Slat", material("Slat", lambda nodes: nodes("BsdfDiffuse", Color=(0.7, 0.7, 0.7))), (3.0, 0.2, 0.01))
    for row in range(count):
        add_object(f"Slat {row}", slat, (place[0], place[1], place[2] + 0.2 * row), (35, 0, 0))


def statues(levels: int, place: tuple[float, float] = (0.0, 0.0)) -> None:
    """A head of marble, and a figure of milk."""
    x, y = place
    suzanne(material("Marble", marble), (x - 0.75, y, 0.8), 1.5, 25.0, levels)
    profile = [
        (0.0, 0.0), (0.5, 0.0), (0.5, 0.12), (0.3, 0.3), (0.2, 0.7), (0.2, 0.9), (0.36, 1.0), (0.2, 1.08),
        (0.36, 1.3), (0.33, 1.5), (0.18, 1.64), (0.0, 1.68),
    ]  # fmt: skip
    figure = turned("Figure", profile, material("Milk", milk))
    figure.location = (x + 0.85, y, 0.002)


def points_of(item: Any, count: int) -> np.ndarray:
    """Evenly distributed points of an object's surface, in the world.

    Returns
    -------
    float32 (count, 3)
    """
    bpy.context.view_layer.update()
    shown = item.evaluated_get(bpy.context.evaluated_depsgraph_get())
    data = shown.to_mesh()
    data.calc_loop_triangles()
    corners = np.zeros(3 * len(data.loop_triangles), np.int32)
    data.loop_triangles.foreach_get("vertices", corners)
    vertices = np.zeros(3 * len(data.vertices), np.float32)
    data.vertices.foreach_get("co", vertices)
    shown.to_mesh_clear()
    a, b, c = vertices.reshape(-1, 3)[corners.reshape(-1, 3)].transpose(1, 0, 2)
    areas = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    rng = np.random.default_rng(7)
    chosen = rng.choice(len(areas), count, p=areas / areas.sum())
    u, v = rng.random((2, count, 1))
    flipped = u + v > 1.0
    u, v = np.where(flipped, 1.0 - u, u), np.where(flipped, 1.0 - v, v)
    local = a[chosen] + u * (b - a)[chosen] + v * (c - a)[chosen]
    turn = np.array(item.matrix_world)
    placed: np.ndarray = (local @ turn[:3, :3].T + turn[:3, 3]).astype(np.float32)
    return placed


def bust(count: int, radius: float, location: Any = (0.0, 0.0, 1.0), turn: float = 20.0) -> None:
    """A head scanned as points, each with a colour and a radius."""
    head = suzanne(None, location, 1.7, turn, levels=2)
    places = points_of(head, count)
    bpy.data.objects.remove(head)
    data = mesh("Bust", places.tolist(), [])
    rng = np.random.default_rng(8)
    wave = 0.5 + 0.5 * np.sin(9.0 * places[:, 2:] + np.array([0.0, 0.6, 1.2]))
    colors = np.concatenate([0.2 + 0.6 * wave, np.ones((count, 1))], axis=1)
    data.attributes.new("tint", "FLOAT_COLOR", "POINT").data.foreach_set("color", colors.astype(np.float32).ravel())
    radii = radius * rng.uniform(0.6, 1.2, count).astype(np.float32)
    data.attributes.new("size", "FLOAT", "POINT").data.foreach_set("value", radii)
    surface = material("Scan", lambda nodes: nodes(
        "BsdfPrincipled", Base_Color=nodes("Attribute", {"attribute_name": "tint"}), Roughness=0.35
    ))  # fmt: skip
    add_object("Bust", data).modifiers.new("Points", "NODES").node_group = _to_points(surface)


def _to_points(surface: Any) -> Any:
    """Geometry nodes that make each vertex a point, as large as its attribute `size`."""
    tree = bpy.data.node_groups.new("Points", "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        tree.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    enter, leave = tree.nodes.new("NodeGroupInput"), tree.nodes.new("NodeGroupOutput")
    size = tree.nodes.new("GeometryNodeInputNamedAttribute")
    size.data_type, size.inputs["Name"].default_value = "FLOAT", "size"
    points, paint = tree.nodes.new("GeometryNodeMeshToPoints"), tree.nodes.new("GeometryNodeSetMaterial")
    paint.inputs["Material"].default_value = surface
    tree.links.new(enter.outputs[0], points.inputs["Mesh"])
    tree.links.new(size.outputs["Attribute"], points.inputs["Radius"])
    tree.links.new(points.outputs[0], paint.inputs["Geometry"])
    tree.links.new(paint.outputs["Geometry"], leave.inputs[0])
    return tree


@scene("matter-head")
def head() -> None:
    """A head of skin with Principled Hair, a lamp behind its ears."""
    stage()
    haired_head(2000, 0.02)
    light("AREA", 150.0, (1.5, 2.5, 2.5), size=1.0)
    light("AREA", 100.0, (-2.0, -3.0, 3.0), size=2.0)
    world((0.15, 0.15, 0.18))


def rug_under_blinds(strands: int, thickness: float) -> None:
    """The rug in stripes of light."""
    stage()
    rug(strands, thickness)
    blinds((0.0, 1.6, 1.3))
    light("SPOT", 900.0, (0.0, 4.5, 4.2), (0.0, 0.0, 0.0), shadow_soft_size=0.06, spot_size=0.9)
    world((0.1, 0.1, 0.12))


@scene("matter-rug")
def small_rug() -> None:
    """A hairy rug under a lamp behind blinds."""
    rug_under_blinds(2000, 0.03)


@scene("matter-statues")
def small_statues() -> None:
    """A head of marble with veins beside a figure of milk."""
    lit_stage()
    statues(1)


@scene("matter-bust")
def small_bust() -> None:
    """A head of points, each of a colour of its own."""
    lit_stage()
    bust(3000, 0.03, ORIGIN[:2] + (1.0,))
    camera((0.0, -5.0, 1.6), (0.0, 0.0, 0.9))
