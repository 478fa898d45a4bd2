# SPDX-License-Identifier: GPL-3.0-or-later
"""What Cycles makes of a node: all cases in one render, each on its own patch of a sheet of quads.

The inputs of a case vary over its patch (three UV maps) and are written, like its output, to a pass of the render:
what our kernel is fed with is bit for bit what Cycles' node was fed with.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

#: Pixels along the edge of a patch.
PATCH = 12


@dataclass
class NodeCase:
    """One node with its settings.

    Attributes
    ----------
    inputs : dict
        Socket identifier to a constant or to a source: 'A' or 'B' (vectors), 'A.x' ... 'B.z' (numbers), optionally
        scaled: ('A', 3.0).
    set_up : callable
        Called with the Blender node, for ramps and curves.
    """

    kind: str
    output: str
    inputs: dict[str, Any] = field(default_factory=dict)
    properties: dict[str, Any] = field(default_factory=dict)
    set_up: Callable[[Any], None] | None = None
    #: Filled in by `render_cases`.
    baked: dict[str, Any] = field(default_factory=dict)
    label: str = ""

    def name(self) -> str:
        values = [str(value) for value in self.properties.values()]
        constants = [f"{key}={value}" for key, value in self.inputs.items() if isinstance(value, int | float)]
        return "-".join([self.kind.removeprefix("ShaderNode"), *values, *constants, self.label, self.output]).replace(
            "--", "-"
        )


def _source(tree: Any, vectors: dict[str, Any], value: Any) -> Any:
    """Output socket of a node tree that carries `value` of a case."""
    factor = None
    if isinstance(value, tuple) and isinstance(value[0], str):
        value, factor = value
    name, _, axis = value.partition(".")
    socket = vectors[name]
    if axis:
        split = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(socket, split.inputs[0])
        socket = split.outputs["xyz".index(axis)]
        if factor is not None:
            product = tree.nodes.new("ShaderNodeMath")
            product.operation = "MULTIPLY"
            tree.links.new(socket, product.inputs[0])
            product.inputs[1].default_value = factor
            socket = product.outputs[0]
    elif factor is not None:
        product = tree.nodes.new("ShaderNodeVectorMath")
        product.operation = "MULTIPLY"
        tree.links.new(socket, product.inputs[0])
        product.inputs[1].default_value = (factor, factor, factor)
        socket = product.outputs[0]
    return socket


def _bake(node: Any) -> dict[str, Any]:
    """What the add-on hands to the engine beside a node's own properties: ramps and curves as tables, versions."""
    from addon.export.node_tables import bake_curves, bake_ramp
    from addon.export.node_versions import modernize
    from engine.scene.description import Node

    if node.bl_idname == "ShaderNodeTexMagic":
        return modernize(Node(node.bl_idname, node.name), 0)[-1].properties
    if node.bl_idname == "ShaderNodeValToRGB":
        ramp = node.color_ramp
        return {"ramp": bake_ramp(ramp), "interpolate": ramp.interpolation != "CONSTANT"}
    return bake_curves(node.mapping, node.bl_idname) if hasattr(node, "mapping") else {}


def _material(bpy: Any, case: NodeCase) -> Any:
    material = bpy.data.materials.new(case.name()[:50])
    tree = material.node_tree
    if tree is None:
        material.use_nodes = True
        tree = material.node_tree
    tree.nodes.clear()
    maps = []
    for index in range(3):
        uv = tree.nodes.new("ShaderNodeUVMap")
        uv.uv_map = f"uv{index}"
        split = tree.nodes.new("ShaderNodeSeparateXYZ")
        tree.links.new(uv.outputs[0], split.inputs[0])
        maps += [split.outputs[0], split.outputs[1]]
    vectors = {}
    for name, sockets in (("A", (maps[0], maps[1], maps[2])), ("B", (maps[3], maps[4], maps[5]))):
        join = tree.nodes.new("ShaderNodeCombineXYZ")
        for socket, target in zip(sockets, join.inputs, strict=True):
            tree.links.new(socket, target)
        vectors[name] = join.outputs[0]

    node = tree.nodes.new(case.kind)
    for key, value in case.properties.items():
        setattr(node, key, value)
    if case.set_up is not None:
        case.set_up(node)
    case.baked = _bake(node)
    sockets = {socket.identifier: socket for socket in node.inputs}
    for key, value in case.inputs.items():
        if isinstance(value, str) or (isinstance(value, tuple) and isinstance(value[0], str)):
            tree.links.new(_source(tree, vectors, value), sockets[key])
        elif sockets[key].type == "RGBA":
            sockets[key].default_value = (*value, 1.0)
        else:
            sockets[key].default_value = value
    result = next(socket for socket in node.outputs if socket.identifier == case.output)
    for name, socket in (("A", vectors["A"]), ("B", vectors["B"]), ("R", result)):
        aov = tree.nodes.new("ShaderNodeOutputAOV")
        aov.aov_name = name
        tree.links.new(socket, aov.inputs[0])
    emission = tree.nodes.new("ShaderNodeEmission")
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(emission.outputs[0], output.inputs[0])
    return material


def _build_sheet(bpy: Any, cases: list[NodeCase], columns: int, rows: int) -> None:
    vertices, faces = [], []
    for index in range(len(cases)):
        x, y = index % columns, index // columns
        start = len(vertices)
        vertices += [(x, y, 0.0), (x + 1, y, 0.0), (x + 1, y + 1, 0.0), (x, y + 1, 0.0)]
        faces.append((start, start + 1, start + 2, start + 3))
    mesh = bpy.data.meshes.new("sheet")
    mesh.from_pydata(vertices, [], faces)
    # Corner values make every coordinate vary over the patch in its own direction, through positive and negative.
    corners = np.array(
        (
            ((-1.3, -0.9), (1.4, -1.1), (1.2, 1.5), (-1.1, 1.3)),
            ((1.25, -1.45), (-0.85, -1.2), (-1.35, 1.1), (0.95, 1.4)),
            ((-0.7, 1.6), (0.2, -0.4), (1.7, -1.5), (0.35, 0.3)),
        ),
        np.float32,
    )
    for index in range(3):
        layer = mesh.uv_layers.new(name=f"uv{index}")
        layer.data.foreach_set("uv", np.tile(corners[index].ravel(), len(cases)))
    for index, case in enumerate(cases):
        mesh.materials.append(_material(bpy, case))
        mesh.polygons[index].material_index = index
    scene = bpy.context.scene
    scene.collection.objects.link(bpy.data.objects.new("sheet", mesh))
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    camera.data.type = "ORTHO"
    camera.data.ortho_scale = max(columns, rows)
    camera.location = (columns / 2, rows / 2, 5.0)
    scene.collection.objects.link(camera)
    scene.camera = camera


def render_cases(cases: list[NodeCase], folder: Path) -> list[tuple[dict[str, np.ndarray], np.ndarray]]:
    """Render all cases with Cycles.

    Returns
    -------
    list of (inputs, result)
        Per case: 'A' and 'B', float32 (pixels, 3), and the node's output, float32 (pixels, 3).
    """
    import bpy
    import OpenEXR

    bpy.ops.wm.read_factory_settings(use_empty=True)
    columns = math.ceil(math.sqrt(len(cases)))
    rows = math.ceil(len(cases) / columns)
    _build_sheet(bpy, cases, columns, rows)
    scene = bpy.context.scene
    for name in "ABR":
        aov = scene.view_layers[0].aovs.add()
        aov.name = name
        aov.type = "COLOR"
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    scene.cycles.samples = 1
    scene.cycles.use_adaptive_sampling = False
    scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    scene.cycles.filter_width = 0.01
    render = scene.render
    render.resolution_x, render.resolution_y, render.resolution_percentage = columns * PATCH, rows * PATCH, 100
    if hasattr(render.image_settings, "media_type"):
        render.image_settings.media_type = "MULTI_LAYER_IMAGE"
    render.image_settings.file_format = "OPEN_EXR_MULTILAYER"
    render.image_settings.color_depth = "32"
    render.filepath = str(folder / "nodes.exr")
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(render.filepath, separate_channels=True) as file:
        channels = {
            name.split(".", 1)[-1]: channel.pixels for part in file.parts for name, channel in part.channels.items()
        }
    passes = {
        name: np.stack([channels[f"{name}.{component}"] for component in "RGB"], axis=-1)[::-1] for name in "ABR"
    }
    results = []
    for index in range(len(cases)):
        x, y = index % columns * PATCH, index // columns * PATCH
        patch = {name: image[y : y + PATCH, x : x + PATCH].reshape(-1, 3) for name, image in passes.items()}
        results.append(({"A": patch["A"], "B": patch["B"]}, patch["R"]))
    return results


def node_inputs(case: NodeCase, sources: dict[str, np.ndarray]) -> dict[str, Any]:
    """The inputs of a case as `node_runner.run_node` takes them."""
    values: dict[str, Any] = {}
    for key, value in case.inputs.items():
        factor = None
        if isinstance(value, tuple) and isinstance(value[0], str):
            value, factor = value
        if isinstance(value, str):
            name, _, axis = value.partition(".")
            value = sources[name]
            if axis:
                value = value[:, "xyz".index(axis)]
            if factor is not None:
                value = value * np.float32(factor)
        values[key] = value
    return values
