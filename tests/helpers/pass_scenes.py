# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes for passes of data, and files of passes read back. Needs bpy."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR

from tests.helpers.motion_scenes import keyframe


def make_material(name: str, surface: Callable[[Any], Any]) -> Any:
    """A material whose surface is the output that `surface` gives for its node tree."""
    import bpy

    material = bpy.data.materials.new(name)
    if material.node_tree is None:
        material.use_nodes = True
    tree = material.node_tree
    tree.nodes.clear()
    output = tree.nodes.new("ShaderNodeOutputMaterial")
    tree.links.new(surface(tree), output.inputs["Surface"])
    return material


def diffuse(tree: Any) -> Any:
    """A white diffuse surface."""
    return tree.nodes.new("ShaderNodeBsdfDiffuse").outputs[0]


def see_through(alpha: float) -> Callable[[Any], Any]:
    """A diffuse surface of which this much is there."""

    def surface(tree: Any) -> Any:
        mix, clear = tree.nodes.new("ShaderNodeMixShader"), tree.nodes.new("ShaderNodeBsdfTransparent")
        mix.inputs[0].default_value = alpha
        tree.links.new(clear.outputs[0], mix.inputs[1])
        tree.links.new(diffuse(tree), mix.inputs[2])
        return mix.outputs[0]

    return surface


def add_aov(tree: Any, name: str) -> Any:
    """An AOV Output node."""
    node = tree.nodes.new("ShaderNodeOutputAOV")
    if hasattr(node, "aov_name"):
        node.aov_name = name
    else:
        node.name = name
    return node


def add_object(name: str, kind: str, material: Any = None, **arguments: Any) -> Any:
    """A primitive mesh in the scene."""
    import bpy

    getattr(bpy.ops.mesh, f"primitive_{kind}_add")(**arguments)
    added = bpy.context.object
    added.name = name
    if material is not None:
        added.data.materials.append(material)
    return added


def busy_scene(scene: Any) -> Any:
    """Fill a scene with a camera and a sun with what passes of data tell apart; returns its view layer.

    A floor, a cube that moves and turns, a ball that changes its shape and has no material, panes of alpha 0.3 and 0.7,
    a holdout that is the cube's child, and a camera that moves; the frame is 1.
    """
    import bpy

    def with_aovs(tree: Any) -> Any:
        geometry, coordinates = tree.nodes.new("ShaderNodeNewGeometry"), tree.nodes.new("ShaderNodeTexCoord")
        tree.links.new(geometry.outputs["Position"], add_aov(tree, "Place").inputs["Color"])
        tree.links.new(coordinates.outputs["UV"], add_aov(tree, "Amount").inputs["Value"])
        return diffuse(tree)

    for item in list(scene.objects):
        if item.type == "MESH":
            bpy.data.objects.remove(item)
    opaque = make_material("Opaque", with_aovs)
    add_object("Floor", "plane", opaque, size=12)
    cube = add_object("Cube", "cube", opaque, size=1.6)
    ball = add_object("Ball", "uv_sphere", radius=0.8, location=(1.2, 0.4, 0.8), segments=16, ring_count=8)
    upright = {"rotation": (1.5, 0.0, 0.0), "size": 1.4}
    add_object("Thin", "plane", make_material("Thin", see_through(0.3)), location=(-0.6, -2.0, 1.0), **upright)
    add_object("Thick", "plane", make_material("Thick", see_through(0.7)), location=(0.9, -2.0, 1.0), **upright)
    hole = add_object("Hole", "cube", opaque, size=0.7, location=(1.3, -1.0, -0.4))
    hole.is_holdout = True
    hole.parent = cube
    keyframe(cube, "location", {0: (-1.6, 0.0, 0.8), 1: (-1.2, 0.0, 0.8), 2: (-1.1, 0.2, 0.9)})
    keyframe(cube, "rotation_euler", {0: (0.0, 0.0, 0.0), 2: (0.0, 0.0, 0.5)})
    keyframe(scene.camera, "location", {0: (-0.1, -7.0, 2.2), 1: (0.0, -7.0, 2.2), 2: (0.3, -6.8, 2.2)})
    scene.camera.rotation_euler = (1.35, 0.0, 0.0)
    ball.shape_key_add(name="Basis")
    swollen = ball.shape_key_add(name="Swollen")
    for point in swollen.data:
        point.co = point.co * 1.3
    keyframe(swollen, "value", {0: 0.0, 1: 0.3, 2: 1.0})
    world = scene.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:
        world.use_nodes = True
    add_aov(world.node_tree, "Place").inputs["Color"].default_value = (0.1, 0.2, 0.3, 1.0)
    world.mist_settings.start, world.mist_settings.depth = 3.0, 8.0
    scene.frame_set(1)
    return scene.view_layers[0]


def render_passes(scene: Any, path: Path) -> tuple[dict[str, np.ndarray], dict[str, str]]:
    """Render into a multilayer EXR and read it again.

    Returns
    -------
    images : dict of float64 (height, width), by channel
    metadata : dict of str
    """
    import bpy

    settings = scene.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format, settings.color_depth = "OPEN_EXR_MULTILAYER", "32"
    if hasattr(settings, "use_exr_interleave"):
        # What other programs read everywhere: one part with all channels.
        settings.use_exr_interleave = True
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    with OpenEXR.File(str(path), separate_channels=True) as file:
        images = {
            name: np.array(channel.pixels, np.float64) for part in file.parts for name, channel in part.channels.items()
        }
        metadata = {name: value for part in file.parts for name, value in part.header.items() if isinstance(value, str)}
    return images, metadata


def render_both(scene: Any, folder: Path, samples: int) -> list[tuple[dict[str, np.ndarray], dict[str, str]]]:
    """`render_passes` of our engine, unguided and by paths alone, and of Cycles, through a box filter."""
    scene.neuralguide.samples = scene.cycles.samples = samples
    scene.neuralguide.guiding_method, scene.neuralguide.caustics = "OFF", "PATHS"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    found = []
    for scene.render.engine in ("NEURALGUIDE", "CYCLES"):
        found.append(render_passes(scene, folder / f"{scene.render.engine}.exr"))
    return found
