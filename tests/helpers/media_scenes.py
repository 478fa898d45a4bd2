# SPDX-License-Identifier: GPL-3.0-or-later
"""Boxes of media, seen from straight above: what they do to light can be worked out on paper."""

from __future__ import annotations

import numpy as np

from engine.scene.description import Frame, Link, Material, Mesh, Node, NodeGraph, SceneDescription, World
from engine.scene.grids import VolumeMotion, pack_grid
from engine.scene.instances import plain_instances
from tests.helpers.small_scenes import looking_down

_CORNERS = np.array([(x, y, z) for z in (-1, 1) for y in (-1, 1) for x in (-1, 1)], np.float32)
_TRIANGLES = np.array(
    [(0, 2, 3), (0, 3, 1), (4, 5, 7), (4, 7, 6), (0, 1, 5), (0, 5, 4), (2, 6, 7), (2, 7, 3), (0, 4, 6), (0, 6, 2),
     (1, 3, 7), (1, 7, 5)], np.uint32,
)  # fmt: skip


def volume_graph(kind, surface=None, **inputs):
    """A graph of one volume node, and of one surface node of kind `surface`."""
    properties = {"phase": inputs.pop("phase")} if "phase" in inputs else {}
    nodes = [Node(f"ShaderNodeVolume{kind}", kind, inputs, properties)]
    link = None
    if surface is not None:
        nodes.append(Node(surface, "Surface", {"IOR": 1.0, "Roughness": 0.0}))
        link = Link(1, "BSDF")
    return NodeGraph(nodes, link, Link(0, "Volume"))


def medium(kind, surface=None, name="Medium", **inputs):
    """A material that is a medium inside."""
    return Material(name, name, volume_graph(kind, surface, **inputs))


def placed(scale=(1.0, 1.0, 1.0), offset=(0.0, 0.0, 0.0)):
    """Object to world of a box of edges `2 * scale` [m]."""
    matrix = np.diag([*scale, 1.0]).astype(np.float32)
    matrix[:3, 3] = offset
    return matrix


def media_scene(materials, transforms, *, lights=(), world=(1.0, 1.0, 1.0), fog=None, height=10.0, size=(8, 8)):
    """Boxes of these materials under a uniform sky, by a camera of a narrow view `height` metres above the origin.

    `fog` is the graph of what fills the world.
    """
    camera = looking_down(height)
    camera.lens = 2000.0
    sky = World("sky", "Sky", None, world)
    if fog is not None:
        fog.nodes.append(Node("ShaderNodeBackground", "Background", {"Color": (*world, 1.0), "Strength": 1.0}))
        fog.surface = Link(len(fog.nodes) - 1, "Background")
        sky = World("sky", "Sky", fog)
    instances = plain_instances(np.reshape(transforms, (-1, 4, 4)), materials=list(range(len(materials))), name="Box")
    mesh = Mesh("box", "Box", _CORNERS, _TRIANGLES, None, np.zeros(12, np.int32))
    return SceneDescription(
        camera=camera, frame=Frame(*size, (0, 0, *size)), meshes=[mesh], instances=instances, materials=materials,
        images=[], lights=list(lights), world=sky,
    )


def put_into_ball(scene, rows=12, columns=24):
    """Make a scene's boxes balls of radius 1 (in their own space), of flat faces, and let its camera see all of one."""
    polar, around = np.linspace(0.0, np.pi, rows + 1), np.linspace(0.0, 2.0 * np.pi, columns, endpoint=False)
    sine = np.sin(polar)[:, None]
    height = np.broadcast_to(np.cos(polar)[:, None], (rows + 1, columns))
    vertices = np.stack([sine * np.cos(around), sine * np.sin(around), height], axis=2)
    first = np.arange(rows * columns)
    second = first - first % columns + (first + 1) % columns
    triangles = np.concatenate([
        np.stack([first, first + columns, second + columns], axis=1)[: (rows - 1) * columns],
        np.stack([first, second + columns, second], axis=1)[columns:],
    ])  # fmt: skip
    scene.meshes[0] = Mesh(
        "ball", "Ball", vertices.reshape(-1, 3).astype(np.float32), triangles.astype(np.uint32), None,
        np.zeros(len(triangles), np.int32),
    )
    scene.camera.lens = 150.0
    return scene


def varying(kind, socket, factor=1.0, space="Object", name="Varying", **inputs):
    """A material whose `socket` is `factor` times the height in the object's space, from -1 to 1, or the world's."""
    source = {"Object": ("ShaderNodeTexCoord", "Object"), "World": ("ShaderNodeNewGeometry", "Position")}[space]
    nodes = [
        Node(f"ShaderNodeVolume{kind}", kind, {**inputs, socket: Link(1, "Value")}),
        Node("ShaderNodeMath", "Times", {"Value": Link(2, "Z"), "Value_001": factor}, {"operation": "MULTIPLY"}),
        Node("ShaderNodeSeparateXYZ", "Separate", {"Vector": Link(3, source[1])}),
        Node(source[0], "Place"),
    ]
    return Material(name, name, NodeGraph(nodes, None, Link(0, "Volume")))


def grid_of(values, to_index, key="grid"):
    """Voxels, float (X, Y, Z, C), the first at index (0, 0, 0)."""

    def read(start, shape):
        padded = np.zeros((*shape, values.shape[-1]), np.float32)
        x = slice(start[0], min(start[0] + shape[0], values.shape[0]))
        padded[: x.stop - x.start, : values.shape[1], : values.shape[2]] = values[x]
        return padded

    return pack_grid(key, to_index, (0, 0, 0), tuple(size - 1 for size in values.shape[:3]), read)[0]


def box_of_voxels(values, factor=1.0, name="density", **inputs):
    """A box of 2 m that is filled by a grid of voxels, float32 (X, Y, Z, C), its centres from face to face."""
    count = values.shape[0]
    to_index = np.diag([(count - 1) / 2.0] * 3 + [1.0])
    to_index[:3, 3] = (count - 1) / 2.0
    node = Node("ShaderNodeVolumePrincipled", "Principled", {"Density": factor, **inputs})
    scene = media_scene([Material("Cloud", "Cloud", NodeGraph([node], None, Link(0, "Volume")))], [placed()])
    scene.meshes[0].grids[name] = grid_of(values, to_index)
    return scene


def let_voxels_move(scene, velocity, still=0.5):
    """Let what is in the grid of `box_of_voxels` move by its velocity, and its box grow.

    `velocity`: float (X, Y, Z, 3) [m a shutter], as many voxels, in the same places.
    """
    mesh = scene.meshes[0]
    (grid,) = mesh.grids.values()
    mesh.volume_motion = VolumeMotion(grid_of(velocity, grid.to_index, "velocity"), still, 1.0)
    least, most = mesh.volume_motion.displacement()
    mesh.vertices = np.where(mesh.vertices > 0.0, mesh.vertices + most, mesh.vertices + least).astype(np.float32)
    scene.shutter = (-0.25, 0.25)
    return scene
