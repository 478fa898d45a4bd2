# SPDX-License-Identifier: GPL-3.0-or-later
"""A room's lightmap: its walls, floor and ceiling as one object, with UVs and an image of their own. Needs bpy."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from benchmarks.images import Float32Array
from benchmarks.scene_files import emits

#: The largest objects are taken until they have so much of the area that looks at the camera.
_SHARE = 0.9
#: Between islands, of the image's side.
_MARGIN = 0.008
_NAME = "Lightmap"
#: Of texels that no face has; light is nowhere negative.
_NOTHING = -1.0
#: Where the UVs of faces are put that have no texels: beside the image.
_BESIDE = -2.0


class Spent(NamedTuple):
    """What a bake took [s]: of Blender's operator, export and all, and of all threads of this process."""

    seconds: float
    processor_seconds: float


@dataclass(frozen=True)
class Lightmap:
    """An object of the open scene whose materials are baked to an image."""

    item: Any
    image: Any

    def bake(self, scene: Any) -> tuple[Float32Array, Spent]:
        """Bake direct and indirect diffuse light, without colour, by the scene's engine.

        Returns
        -------
        texels : float32 (N, 3), those that faces have
        spent : Spent

        Raises
        ------
        RuntimeError
            If it did not come about.
        """
        import bpy

        self.image.pixels.foreach_set(np.full(len(self.image.pixels), _NOTHING, np.float32))
        _select([self.item])
        start, processor_start = time.monotonic(), time.process_time()
        ended = bpy.ops.object.bake(
            type="DIFFUSE", pass_filter={"DIRECT", "INDIRECT"}, margin=0, use_clear=False,
            use_selected_to_active=False, target="IMAGE_TEXTURES", save_mode="INTERNAL",
        )  # fmt: skip
        spent = Spent(time.monotonic() - start, time.process_time() - processor_start)
        if ended != {"FINISHED"}:
            raise RuntimeError(f"{scene.render.engine} has not baked {self.item.name!r}: {ended}")
        values = np.empty(len(self.image.pixels), np.float32)
        self.image.pixels.foreach_get(values)
        texels = values.reshape(-1, 4)
        return np.ascontiguousarray(texels[texels[:, 3] != _NOTHING, :3]), spent


def make_lightmap(scene: Any, size: int) -> Lightmap:
    """Join the room's largest objects, and give what of them looks at the camera a UV map and an image.

    Parameters
    ----------
    scene : bpy.types.Scene
        The open one, with a camera in the room.
    size : int
        Width and height of the image [pixels].

    Raises
    ------
    ValueError
        If there is nothing to bake, or no camera.
    """
    if scene.camera is None:
        raise ValueError(f"scene {scene.name!r} has no camera: what is inside the room is not known")
    eye = np.array(scene.camera.matrix_world.translation, np.float64)
    item = _join(largest(scene, eye))
    _unwrap(item, facing(item, eye)[0])
    return Lightmap(item, _add_image(item, size))


def facing(item: Any, eye: np.ndarray) -> tuple[np.ndarray, float]:
    """Which polygons of a mesh look at a point, bool (P,), and their area [m^2]."""
    mesh = item.data
    mesh.calc_loop_triangles()
    vertices = np.empty(3 * len(mesh.vertices), np.float32)
    mesh.vertices.foreach_get("co", vertices)
    triangles = np.empty(3 * len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("vertices", triangles)
    polygons = np.empty(len(mesh.loop_triangles), np.int32)
    mesh.loop_triangles.foreach_get("polygon_index", polygons)
    transform = np.array(item.matrix_world, np.float64)
    points = vertices.reshape(-1, 3) @ transform[:3, :3].T + transform[:3, 3]
    a, b, c = points[triangles.reshape(-1, 3)].transpose(1, 0, 2)
    normals = np.cross(b - a, c - a)
    if np.linalg.det(transform[:3, :3]) < 0.0:
        normals = -normals
    looks = np.einsum("ij,ij->i", normals, eye - (a + b + c) / 3.0) > 0.0
    found = np.zeros(len(mesh.polygons), np.bool_)
    found[polygons[looks]] = True
    return found, float(0.5 * np.linalg.norm(normals[looks], axis=1).sum())


def largest(scene: Any, eye: np.ndarray) -> list[Any]:
    """The largest objects that can be joined and baked, by the area that looks at a point.

    Raises
    ------
    ValueError
        If there are none.
    """
    areas = {item: facing(item, eye)[1] for item in scene.objects if _is_fit(item)}
    left, chosen = _SHARE * sum(areas.values()), []
    for item in sorted(areas, key=lambda one: -areas[one]):
        if left <= 0.0:
            break
        chosen.append(item)
        left -= areas[item]
    if not chosen:
        raise ValueError(f"scene {scene.name!r} has no mesh to give a lightmap to")
    return chosen


def _is_fit(item: Any) -> bool:
    """Whether an object is rendered as its mesh is, stands alone, and only reflects."""
    if item.type != "MESH" or item.hide_render or not item.visible_get() or not len(item.data.polygons):
        return False
    if item.modifiers or item.parent or item.children or item.animation_data or item.data.shape_keys:
        return False
    materials = [slot.material for slot in item.material_slots]
    return bool(materials) and all(one is not None and one.node_tree and not emits(one) for one in materials)


def _select(items: Sequence[Any]) -> None:
    """Select these objects alone; the first is active."""
    import bpy

    for item in bpy.context.view_layer.objects:
        item.select_set(item in items)
    bpy.context.view_layer.objects.active = items[0]


def _join(items: Sequence[Any]) -> Any:
    import bpy

    # Others may use the same mesh.
    items[0].data = items[0].data.copy()
    _select(items)
    if len(items) > 1:
        bpy.ops.object.join()
    # Islands are as large as faces are in the object's own space.
    bpy.ops.object.transform_apply(location=False, rotation=False, scale=True)
    return items[0]


def _unwrap(item: Any, wanted: np.ndarray) -> None:
    """Add a UV map of these polygons that has room for each texel once."""
    import bmesh
    import bpy

    mesh = item.data
    mesh.uv_layers.active = mesh.uv_layers.new(name=_NAME, do_init=False)
    _select([item])
    bpy.ops.object.mode_set(mode="EDIT")
    bpy.context.tool_settings.mesh_select_mode = (False, False, True)
    bpy.ops.mesh.select_all(action="DESELECT")
    edited = bmesh.from_edit_mesh(mesh)
    for face, is_wanted in zip(edited.faces, wanted, strict=True):
        face.select = bool(is_wanted)
    bmesh.update_edit_mesh(mesh)
    bpy.ops.uv.smart_project(island_margin=_MARGIN)
    bpy.ops.object.mode_set(mode="OBJECT")
    layer = item.data.uv_layers[_NAME]
    uvs = np.empty(2 * len(layer.data), np.float32)
    layer.data.foreach_get("uv", uvs)
    totals = np.empty(len(mesh.polygons), np.int32)
    mesh.polygons.foreach_get("loop_total", totals)
    # Loops lie in the order of polygons.
    uvs.reshape(-1, 2)[~np.repeat(wanted, totals)] = _BESIDE
    layer.data.foreach_set("uv", uvs)


def _add_image(item: Any, size: int) -> Any:
    """An image that all of an object's materials are baked to."""
    import bpy

    image = bpy.data.images.new(_NAME, size, size, alpha=True, float_buffer=True)
    for material in {slot.material for slot in item.material_slots}:
        nodes = material.node_tree.nodes
        node = nodes.new("ShaderNodeTexImage")
        node.image = image
        for other in nodes:
            other.select = other == node
        nodes.active = node
    return image
