# SPDX-License-Identifier: GPL-3.0-or-later
"""What the scenes share: node wiring in one line, simple meshes, a stage with a floor, a camera and soft light."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any

import bpy
import numpy as np
from mathutils import Vector

Socket = Any
Surface = Callable[["Nodes"], Socket]

WIDTH, HEIGHT = 96, 72
ORIGIN = (0.0, 0.0, 0.0)


class Nodes:
    """A node tree written as expressions: `nodes("BsdfDiffuse", Color=(1, 0, 0))` returns the node's first output.

    Keyword arguments are inputs by name (spaces as underscores), values or sockets; `properties` are the node's
    own settings; `inputs` takes positions or identifiers for names that are taken twice.
    """

    def __init__(self, tree: Any) -> None:
        self.tree = tree
        tree.nodes.clear()

    def node(
        self,
        kind: str,
        properties: dict[str, Any] | None = None,
        inputs: dict[int | str, Any] | None = None,
        **named: Any,
    ) -> Any:
        """Add a node of type `ShaderNode<kind>` and set it up."""
        node = self.tree.nodes.new(f"ShaderNode{kind}")
        for key, value in (properties or {}).items():
            setattr(node, key, value)
        by_name: dict[int | str, Any] = {name.replace("_", " "): value for name, value in named.items()}
        for key, value in {**by_name, **(inputs or {})}.items():
            socket = self._input(node, key)
            if isinstance(value, bpy.types.NodeSocket):
                self.tree.links.new(value, socket)
            elif isinstance(value, Sequence) and not isinstance(value, str):
                wanted = len(socket.default_value)
                socket.default_value = (*value, 1.0)[:wanted] if len(value) < wanted else tuple(value)[:wanted]
            else:
                socket.default_value = value
        return node

    def __call__(self, kind: str, *arguments: Any, output: int | str = 0, **named: Any) -> Socket:
        return self.node(kind, *arguments, **named).outputs[output]

    @staticmethod
    def _input(node: Any, key: int | str) -> Socket:
        if isinstance(key, int):
            return node.inputs[key]
        for socket in node.inputs:
            if socket.identifier == key and socket.enabled:
                return socket
        for socket in node.inputs:
            if socket.name == key and socket.enabled:
                return socket
        raise KeyError(f"{node.bl_idname} has no input {key!r}")


def _outputs(nodes: Nodes, surface: Surface | None, volume: Surface | None) -> dict[str, Any]:
    """Inputs of an output node."""
    made = {"Surface": surface, "Volume": volume}
    return {socket: make(nodes) for socket, make in made.items() if make is not None}


def material(name: str, surface: Surface | None, volume: Surface | None = None) -> Any:
    """A material whose surface is what `surface(nodes)` returns, and whose inside is what `volume(nodes)` does."""
    created = bpy.data.materials.new(name)
    if created.node_tree is None:
        created.use_nodes = True
    nodes = Nodes(created.node_tree)
    nodes.node("OutputMaterial", **_outputs(nodes, surface, volume))
    return created


def diffuse(color: Sequence[float], name: str = "diffuse") -> Any:
    """A Lambertian material."""
    return material(name, lambda nodes: nodes("BsdfDiffuse", Color=color))


def emitter(color: Sequence[float], strength: float) -> Any:
    """An emitting material."""
    return material("emitter", lambda nodes: nodes("Emission", Color=color, Strength=strength))


def add_object(name: str, data: Any, location: Sequence[float] = ORIGIN, rotation: Sequence[float] = ORIGIN) -> Any:
    """Link an object to the scene; rotation in degrees."""
    created = bpy.data.objects.new(name, data)
    created.location = location
    created.rotation_euler = [math.radians(angle) for angle in rotation]
    bpy.context.scene.collection.objects.link(created)
    return created


def mesh(
    name: str,
    vertices: Sequence[Sequence[float]],
    faces: Sequence[Sequence[int]],
    surface: Any = None,
    uvs: Sequence[Sequence[float]] | None = None,
) -> Any:
    """A mesh from lists; `uvs` has one pair per face corner."""
    created = bpy.data.meshes.new(name)
    created.from_pydata([tuple(v) for v in vertices], [], [tuple(f) for f in faces])
    if surface is not None:
        created.materials.append(surface)
    if uvs is not None:
        layer = created.uv_layers.new(name="UVMap")
        layer.data.foreach_set("uv", np.asarray(uvs, np.float32).ravel())
    created.update()
    return created


def quad(name: str, surface: Any, size_x: float = 2.0, size_y: float = 2.0) -> Any:
    """A rectangle in the xy plane facing +z, UV (0, 0) at its lower left."""
    x, y = size_x / 2, size_y / 2
    corners = [(-x, -y, 0), (x, -y, 0), (x, y, 0), (-x, y, 0)]
    return mesh(name, corners, [(0, 1, 2, 3)], surface, [(0, 0), (1, 0), (1, 1), (0, 1)])


def sort_faces(data: Any) -> None:
    """Put a mesh's faces in the order of their vertices.

    Blender makes the faces of a UV sphere in the order of their addresses in memory, which is another one in each
    process; with it the triangles' numbers and the rounding of normals differ.
    """
    import bmesh

    grid = bmesh.new()
    grid.from_mesh(data)
    order = sorted(grid.faces, key=lambda face: [vertex.index for vertex in face.verts])
    for index, face in enumerate(order):
        face.index = index
    grid.faces.sort()
    grid.to_mesh(data)
    grid.free()


def sphere(name: str, surface: Any, radius: float = 1.0, segments: int = 48, rings: int = 24) -> Any:
    """A UV sphere with a UV map."""
    import bmesh

    grid = bmesh.new()
    grid.loops.layers.uv.new("UVMap")
    bmesh.ops.create_uvsphere(grid, u_segments=segments, v_segments=rings, radius=radius, calc_uvs=True)
    created = bpy.data.meshes.new(name)
    grid.to_mesh(created)
    grid.free()
    sort_faces(created)
    created.materials.append(surface)
    created.polygons.foreach_set("use_smooth", [True] * len(created.polygons))
    return created


def box(name: str, surface: Any, size: Sequence[float] = (1.0, 1.0, 1.0)) -> Any:
    """An axis-aligned box about the origin."""
    x, y, z = (s / 2 for s in size)
    corners = [(i, j, k) for i in (-x, x) for j in (-y, y) for k in (-z, z)]
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    uvs = [(0, 0), (1, 0), (1, 1), (0, 1)] * 6
    return mesh(name, corners, faces, surface, uvs)


def aim(thing: Any, target: Sequence[float]) -> None:
    """Turn an object so that its -z looks at `target`."""
    direction = Vector(target) - Vector(thing.location)
    thing.rotation_euler = direction.to_track_quat("-Z", "Y").to_euler()


def camera(
    location: Sequence[float] = (0.0, -6.0, 2.6), target: Sequence[float] = (0.0, 0.0, 0.7), lens: float = 45.0
) -> Any:
    """The scene's camera; returns the object."""
    data = bpy.data.cameras.new("Camera")
    data.lens = lens
    created = add_object("Camera", data, location)
    aim(created, target)
    bpy.context.scene.camera = created
    return created


def light(
    kind: str, energy: float, location: Sequence[float], target: Sequence[float] = (0, 0, 0.5), **settings: Any
) -> Any:
    """A light object aimed at `target`; `settings` are properties of its data."""
    data = bpy.data.lights.new(kind.title(), kind)
    data.energy = energy
    for key, value in settings.items():
        setattr(data, key, value)
    created = add_object(kind.title(), data, location)
    aim(created, target)
    return created


def world(color: Sequence[float] = (0.5, 0.5, 0.5), strength: float = 1.0) -> Any:
    """A uniform world; returns its `Nodes`-cleared tree's owner."""
    return world_nodes(lambda nodes: nodes("Background", Color=color, Strength=strength))


def world_nodes(surface: Surface | None, volume: Surface | None = None) -> Any:
    """A world whose surface is what `surface(nodes)` returns, and which is filled with what `volume(nodes)` does."""
    created = bpy.data.worlds.new("World")
    if created.node_tree is None:
        created.use_nodes = True
    nodes = Nodes(created.node_tree)
    nodes.node("OutputWorld", **_outputs(nodes, surface, volume))
    bpy.context.scene.world = created
    return created


def image(name: str, pixels: np.ndarray, is_float: bool = False, colorspace: str | None = None) -> Any:
    """A packed generated image from (height, width, 4), row 0 at the bottom."""
    height, width = pixels.shape[:2]
    created = bpy.data.images.new(name, width, height, alpha=True, float_buffer=is_float)
    if colorspace is not None:
        created.colorspace_settings.name = colorspace
    created.pixels.foreach_set(np.ascontiguousarray(pixels, np.float32).ravel())
    created.update()
    created.pack()
    return created


def resolution(width: int = WIDTH, height: int = HEIGHT) -> None:
    """Size of the render; clamping off, few bounces, so that noise is all that may differ."""
    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = width, height, 100
    scene.cycles.sample_clamp_direct = scene.cycles.sample_clamp_indirect = 0.0
    scene.cycles.max_bounces = 8
    scene.cycles.diffuse_bounces = scene.cycles.glossy_bounces = 4
    scene.cycles.transmission_bounces = 8
    scene.cycles.blur_glossy = 0.0
    scene.cycles.light_sampling_threshold = 0.0


def stage(floor_color: Sequence[float] = (0.6, 0.6, 0.6), with_camera: bool = True) -> None:
    """A floor, two coloured walls far apart and a camera; no light."""
    resolution()
    add_object("Floor", quad("Floor", diffuse(floor_color, "floor"), 12.0, 12.0))
    add_object("Left", box("Left", diffuse((0.7, 0.15, 0.1), "red"), (0.3, 1.6, 1.4)), (-2.1, 1.2, 0.7))
    add_object("Right", box("Right", diffuse((0.1, 0.2, 0.7), "blue"), (0.3, 1.6, 1.4)), (2.1, 1.2, 0.7))
    if with_camera:
        camera()


def lit_stage() -> None:
    """The stage under a soft world and one large area light: quick to converge, with a shadow to see."""
    stage()
    world((0.5, 0.55, 0.6))
    light("AREA", 200.0, (2.0, -2.0, 4.0), size=4.0)


def show(surface: Any) -> None:
    """A smooth sphere, and a tilted box with flat faces, of the material in question."""
    add_object("Sphere", sphere("Sphere", surface, 0.8), (-0.75, 0.0, 0.8))
    add_object("Box", box("Box", surface, (1.0, 1.0, 1.0)), (0.85, -0.2, 0.72), (20, 10, 35))
