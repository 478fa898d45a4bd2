# SPDX-License-Identifier: GPL-3.0-or-later
"""What Attribute nodes give, in our engine and in Cycles: a sheet of tiles, each with a node of its own. Needs bpy."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.helpers.pass_scenes import add_aov, make_material, render_passes

#: Pixels along the edge of a tile.
TILE = 8

#: Property and width of what Blender's types of attributes hold.
TYPES = {
    "FLOAT": ("value", 1), "INT": ("value", 1), "INT8": ("value", 1), "BOOLEAN": ("value", 1), "FLOAT2": ("vector", 2),
    "INT32_2D": ("value", 2), "INT16_2D": ("value", 2), "FLOAT_VECTOR": ("vector", 3), "FLOAT_COLOR": ("color", 4),
    "BYTE_COLOR": ("color", 4), "QUATERNION": ("value", 4), "FLOAT4X4": ("value", 16),
}  # fmt: skip
DOMAINS = ("POINT", "EDGE", "FACE", "CORNER")

#: Show outputs of an Attribute node: Color, Vector, and Fac and Alpha.
_AOVS = ("As Color", "As Vector", "Numbers")


def attribute_material(kind: str, name: str) -> Any:
    """A material that shows all outputs of an Attribute node in AOVs."""

    def surface(tree: Any) -> Any:
        node, rest = tree.nodes.new("ShaderNodeAttribute"), tree.nodes.new("ShaderNodeCombineXYZ")
        node.attribute_type, node.attribute_name = kind, name
        tree.links.new(node.outputs["Fac"], rest.inputs[0])
        tree.links.new(node.outputs["Alpha"], rest.inputs[1])
        sockets = (node.outputs["Color"], node.outputs["Vector"], rest.outputs[0])
        for aov, socket in zip(_AOVS, sockets, strict=True):
            tree.links.new(socket, add_aov(tree, aov).inputs["Color"])
        emission = tree.nodes.new("ShaderNodeEmission")
        tree.links.new(node.outputs["Color"], emission.inputs["Color"])
        return emission.outputs[0]

    return make_material(f"{kind} {name}", surface)


def rich_mesh() -> Any:
    """A bumpy, smooth sheet of nine faces with two UV maps, a colour, and an attribute of each type and domain."""
    import bpy

    random = np.random.default_rng(1)
    vertices = [(i / 3, j / 3, 0.25 * random.random()) for j in range(4) for i in range(4)]
    faces = [(a, a + 1, a + 5, a + 4) for a in (4 * j + i for j in range(3) for i in range(3))]
    mesh = bpy.data.meshes.new("Rich")
    mesh.from_pydata(vertices, [], faces)
    mesh.polygons.foreach_set("use_smooth", [True] * len(faces))
    flat = np.array([mesh.vertices[loop.vertex_index].co[:2] for loop in mesh.loops]).ravel()
    for name in ("UVMap", "Second"):
        mesh.uv_layers.new(name=name).data.foreach_set("uv", (0.3 * random.random(len(flat)) + flat).astype(np.float32))
    mesh.uv_layers["Second"].active_render = True
    mesh.color_attributes.new("Col", "FLOAT_COLOR", "POINT")
    mesh.color_attributes.render_color_index = 0
    mesh.attributes["Col"].data.foreach_set("color", random.random(64).astype(np.float32))
    for kind, (prop, width) in TYPES.items():
        for domain in DOMAINS:
            stored = mesh.attributes.new(f"{kind} {domain}", kind, domain)
            values = random.random(len(stored.data) * width)
            if "INT" in kind:
                values = np.floor(10.0 * values).astype(np.int32)
            stored.data.foreach_set(prop, values > 0.5 if kind == "BOOLEAN" else values)
    return mesh


def compare_tiles(
    scene: Any, cases: list[tuple[str, str]], folder: Path, set_up: Callable[[Any, int], None] | None = None
) -> list[tuple[np.ndarray, np.ndarray]]:
    """What our engine and Cycles show of Attribute nodes, each on a tile of `rich_mesh`.

    Parameters
    ----------
    scene : Scene
        With a camera; empty but for that.
    cases : list of (kind, name)
        Type of the node, and what it names.
    set_up : callable, optional
        Called with each tile's object and the number of its case.

    Returns
    -------
    list of (ours, theirs)
        Arrays of each case, float64 (9 pixels, 8): Color, Vector, Fac, Alpha.
    """
    import bpy

    columns = math.ceil(math.sqrt(len(cases)))
    rich = rich_mesh()
    for number, (kind, name) in enumerate(cases):
        mesh = rich.copy()
        mesh.materials.append(attribute_material(kind, name))
        tile = bpy.data.objects.new(f"Tile {number}", mesh)
        scene.collection.objects.link(tile)
        tile.location = (number % columns + 0.15, number // columns + 0.05, 0.0)
        tile.rotation_euler, tile.scale = (0.2, 0.1, 0.4), (0.9, 0.95, 0.8)
        group = tile.vertex_groups.new(name="Group")
        for vertex in range(16):
            if vertex % 3:
                group.add([vertex], (vertex + 1) / 20, "REPLACE")
        if set_up is not None:
            set_up(tile, number)
    for name in _AOVS:
        aov = scene.view_layers[0].aovs.add()
        aov.name, aov.type = name, "COLOR"
    camera, render = scene.camera, scene.render
    camera.data.type, camera.data.ortho_scale = "ORTHO", columns
    camera.location = (columns / 2, columns / 2, 5.0)
    render.resolution_x = render.resolution_y = columns * TILE
    ours, theirs = ({name: _colors(images, name) for name in _AOVS} for images in render_points(scene, folder))
    found = []
    for number in range(len(cases)):
        middle = tuple(slice(TILE * at + 3, TILE * at + 6) for at in divmod(number, columns))
        found.append(tuple(
            np.concatenate([images[name][middle].reshape(9, 3) for name in _AOVS], axis=1)[:, :8]
            for images in (ours, theirs)
        ))  # fmt: skip
    return found  # type: ignore[return-value]


def render_points(scene: Any, folder: Path) -> list[dict[str, np.ndarray]]:
    """What our engine and Cycles see at the middle of each pixel, by channel."""
    scene.render.resolution_percentage = 100
    for settings in (scene.neuralguide, scene.cycles):
        settings.samples, settings.filter_width = 1, 0.01
    scene.neuralguide.pixel_filter = scene.cycles.pixel_filter_type = "BLACKMAN_HARRIS"
    scene.neuralguide.guiding_method = "OFF"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    found = []
    for scene.render.engine in ("NEURALGUIDE", "CYCLES"):
        images, _ = render_passes(scene, folder / f"{scene.render.engine}.exr")
        found.append({name.split(".", 1)[-1]: image[::-1] for name, image in images.items()})
    return found


def _colors(images: dict[str, np.ndarray], name: str) -> np.ndarray:
    return np.stack([images[f"{name}.{channel}"] for channel in "RGB"], axis=-1)
