# SPDX-License-Identifier: GPL-3.0-or-later
"""Scenes to bake, and bakes of them. Needs bpy."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array

SIZE = 16


def add_image(item: Any, name: str = "Baked", size: int = SIZE, tiles: int = 1) -> Any:
    """An image that the object's material is baked to, with values of 0.25."""
    import bpy

    image = bpy.data.images.new(name, size, size, alpha=True, float_buffer=True, tiled=tiles > 1)
    for number in range(1002, 1001 + tiles):
        tile = image.tiles.new(number)
        image.tiles.active = tile
        with bpy.context.temp_override(edit_image=image):
            bpy.ops.image.tile_fill(width=size, height=size, float=True, alpha=True)
    if tiles == 1:
        image.pixels.foreach_set(np.full(size * size * 4, 0.25, np.float32))
    tree = item.active_material.node_tree
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = image
    tree.nodes.active = node
    return image


def baked_plane(scene: Any) -> tuple[Any, Any]:
    """A reddish plane whose UVs cover a quarter of its image, a box over it, a sun and a sky: plane and image."""
    import bpy

    bpy.ops.mesh.primitive_cube_add(size=0.6, location=(0.4, 0.2, 0.6))
    bpy.ops.mesh.primitive_plane_add()
    plane = bpy.context.object
    plane.name = "Plane"
    material = bpy.data.materials.new("Baked")
    if material.node_tree is None:
        material.use_nodes = True
    surface = material.node_tree.nodes["Principled BSDF"]
    surface.inputs["Base Color"].default_value = (0.8, 0.4, 0.2, 1.0)
    surface.inputs["Emission Color"].default_value = (0.5, 0.25, 1.0, 1.0)
    surface.inputs["Emission Strength"].default_value = 0.5
    plane.data.materials.append(material)
    for corner in plane.data.uv_layers[0].data:
        corner.uv = corner.uv * 0.5
    world = scene.world = bpy.data.worlds.new("Sky")
    if world.node_tree is None:
        world.use_nodes = True
    world.node_tree.nodes["Background"].inputs[0].default_value = (0.3, 0.5, 0.8, 1.0)
    sun = bpy.data.objects.new("Sun", bpy.data.lights.new("Sun", "SUN"))
    sun.rotation_euler = (0.6, 0.3, 0.0)
    sun.data.energy = 2.0
    scene.collection.objects.link(sun)
    return plane, add_image(plane)


def bake(
    scene: Any, image: Any, by: str, kind: str, samples: int, guiding_method: str = "OFF", *, denoises: bool = False,
    **options: Any,
) -> Float32Array:
    """The image after a bake by an engine, NEURALGUIDE or CYCLES: float32 (H, W, 4)."""
    import bpy

    scene.render.engine = by
    scene.cycles.samples = scene.neuralguide.samples = samples
    scene.cycles.use_adaptive_sampling, scene.cycles.use_denoising = False, denoises
    scene.neuralguide.guiding_method = guiding_method
    assert bpy.ops.object.bake(type=kind, **{"margin": 0, **options}) == {"FINISHED"}
    return pixels_of(image)


def pixels_of(image: Any) -> Float32Array:
    """Float32 (H, W, 4)."""
    values: npt.NDArray[np.float32] = np.empty(len(image.pixels), np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(image.size[1], image.size[0], 4)
