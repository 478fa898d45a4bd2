# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated meshes to arrays of triangles."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array
from engine.scene.description import Attribute, Mesh

from ..versions import NORMALS_STOP_AT_FLAT_FACES, is_since
from .attributes import read_attribute, read_uv_map
from .context import CachedMesh, ExportContext
from .materials import AttributeRequest
from .tangents import compute_tangents
from .topology import Topology, gather, read_topology

#: Undeformed positions of a deformed mesh, for Generated coordinates (before the texture space is applied).
UNDEFORMED = "__undeformed"


def export_mesh(
    context: ExportContext, mesh: bpy.types.Mesh, owner: bpy.types.Object, request: AttributeRequest
) -> Mesh | None:
    """The triangles of an evaluated mesh; None if it has none.

    A mesh equal to the one last exported from the same place is that very object again.

    Parameters
    ----------
    owner : Object
        Whose evaluation made the mesh.
    """
    original = owner.original
    names = (original.name_full, mesh.name_full)
    number = context.mesh_counts[names] = context.mesh_counts.get(names, -1) + 1
    identity = (*names, number)
    kept = context.cache.meshes.get(identity)
    if kept is not None and kept.request == request and _is_untouched(context, original):
        kept.last_used = context.cache.export_count
        return kept.mesh
    exported = _read_mesh(context, mesh, owner, request)
    if exported is None:
        context.cache.meshes.pop(identity, None)
        return None
    if kept is not None and is_equal(kept.mesh, exported):
        exported = kept.mesh
    else:
        exported.key = (*identity, context.cache.new_version())
    context.cache.meshes[identity] = CachedMesh(exported, request, context.cache.export_count)
    return exported


def is_equal(a: Mesh, b: Mesh) -> bool:
    """Whether two meshes have the same content, keys aside."""
    if a.name != b.name or a.default_uv != b.default_uv or a.default_color != b.default_color:
        return False
    if a.attributes.keys() != b.attributes.keys():
        return False
    pairs: list[tuple[np.ndarray | None, np.ndarray | None]] = [
        (a.vertices, b.vertices),
        (a.triangles, b.triangles),
        (a.corner_normals, b.corner_normals),
        (a.material_slots, b.material_slots),
        (a.texture_space, b.texture_space),
    ]
    for name, attribute in a.attributes.items():
        if attribute.domain != b.attributes[name].domain:
            return False
        pairs.append((attribute.data, b.attributes[name].data))
    return all(_same_bits(x, y) for x, y in pairs)


def _same_bits(a: np.ndarray | None, b: np.ndarray | None) -> bool:
    """Bitwise, so that NaN equals itself."""
    if a is None or b is None:
        return a is b
    return a.shape == b.shape and np.array_equal(a.reshape(-1).view(np.uint32), b.reshape(-1).view(np.uint32))


def _is_untouched(context: ExportContext, original: bpy.types.Object) -> bool:
    return context.is_untouched(original) and (original.data is None or context.is_untouched(original.data))


def _read_mesh(
    context: ExportContext, mesh: bpy.types.Mesh, owner: bpy.types.Object, request: AttributeRequest
) -> Mesh | None:
    mesh.calc_loop_triangles()
    triangle_count = len(mesh.loop_triangles)
    if triangle_count == 0:
        return None
    topology = read_topology(mesh, triangle_count)
    vertices = read_positions(mesh)
    context.check_cancel()
    exported = Mesh(
        key=None,
        name=mesh.name,
        vertices=vertices,
        triangles=topology.vertices,
        corner_normals=read_normals(mesh, topology),
        material_slots=_read_material_slots(mesh, topology),
    )
    context.check_cancel()
    _add_attributes(context, mesh, owner, request, topology, exported)
    exported.texture_space = np.array([mesh.texspace_location, mesh.texspace_size], np.float32)
    return exported


def read_positions(mesh: bpy.types.Mesh) -> Float32Array:
    """Positions of the vertices, float32 (V, 3)."""
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    position = mesh.attributes.get("position")
    if position is not None:
        position.data.foreach_get("vector", flat)
    else:
        mesh.vertices.foreach_get("co", flat)
    return flat.reshape(-1, 3)


def read_normals(mesh: bpy.types.Mesh, topology: Topology) -> Float32Array | None:
    """Normals of the triangles' corners, float32 (T, 3, 3), or None where every face is flat.

    Where Cycles takes Blender's own normals of corners, which stop at flat faces and sharp edges, so do we. Else smooth
    faces have their vertices' normals, over all faces around them, and triangles of flat faces their own.
    """
    is_flat = _read_flat_faces(mesh)
    if is_flat.all():
        return None
    if _has_normals_of_corners(mesh):
        return gather(_read_corner_normals(mesh), topology.corners).reshape(-1, 3, 3)
    flat = np.empty(len(mesh.vertices) * 3, np.float32)
    if hasattr(mesh, "vertex_normals"):
        mesh.vertex_normals.foreach_get("vector", flat)
    else:
        mesh.vertices.foreach_get("normal", flat)
    normals = gather(flat.reshape(-1, 3), topology.vertices.reshape(-1)).reshape(-1, 3, 3)
    if is_flat.any():
        of_triangles = gather(is_flat, topology.polygons)
        normals[of_triangles] = _flat_normals(read_positions(mesh), topology.vertices[of_triangles])[:, None]
    return normals


def _read_flat_faces(mesh: bpy.types.Mesh) -> npt.NDArray[np.bool_]:
    """Which faces are flat; where no face says so, sharp edges or normals of faces may make all of them flat."""
    if hasattr(mesh, "normals_domain") and "sharp_face" not in mesh.attributes:
        return np.full(len(mesh.polygons), mesh.normals_domain == "FACE")
    is_smooth = np.empty(len(mesh.polygons), bool)
    mesh.polygons.foreach_get("use_smooth", is_smooth)
    return ~is_smooth


def _has_normals_of_corners(mesh: bpy.types.Mesh) -> bool:
    """Whether Cycles takes normals of corners, not of vertices."""
    if not hasattr(mesh, "normals_domain"):
        return mesh.use_auto_smooth
    if mesh.normals_domain != "CORNER":
        return False
    # Custom normals that are free vectors are an attribute only.
    return (
        is_since(NORMALS_STOP_AT_FLAT_FACES)
        or mesh.has_custom_normals
        or "custom_normal" in mesh.attributes
        or _has_sharp_edges(mesh)
    )


def _read_corner_normals(mesh: bpy.types.Mesh) -> Float32Array:
    """Blender's own, float32 (corners, 3)."""
    flat = np.empty(len(mesh.loops) * 3, np.float32)
    if hasattr(mesh, "corner_normals"):
        mesh.corner_normals.foreach_get("vector", flat)
    else:
        # Before Blender 4.1 normals are split on demand.
        mesh.calc_normals_split()
        mesh.loops.foreach_get("normal", flat)
        mesh.free_normals_split()
    return flat.reshape(-1, 3)


def _flat_normals(vertices: Float32Array, triangles: npt.NDArray[np.integer]) -> Float32Array:
    """Normals of the planes of triangles, float32 (T, 3); (0, 0, 1) for those that are degenerate."""
    a, b, c = (vertices[triangles[:, corner]].astype(np.float64) for corner in range(3))
    normals = np.cross(b - a, c - a)
    lengths = np.linalg.norm(normals, axis=1)
    is_degenerate = ~(lengths > 0.0)
    normals[is_degenerate], lengths[is_degenerate] = (0.0, 0.0, 1.0), 1.0
    return (normals / lengths[:, None]).astype(np.float32)


def _has_sharp_edges(mesh: bpy.types.Mesh) -> bool:
    stored = mesh.attributes.get("sharp_edge")
    if stored is None:
        return False
    is_sharp = np.empty(len(stored.data), bool)
    stored.data.foreach_get("value", is_sharp)
    return bool(is_sharp.any())


def _read_material_slots(mesh: bpy.types.Mesh, topology: Topology) -> Int32Array:
    """Slot of each triangle; negative ones, which only scripts can make, are the first slot."""
    stored = mesh.attributes.get("material_index")
    if stored is None or len(mesh.polygons) == 0:
        return np.zeros(len(topology.polygons), np.int32)
    slots = np.empty(len(mesh.polygons), np.int32)
    if stored.domain == "FACE" and stored.data_type == "INT":
        stored.data.foreach_get("value", slots)
    else:
        mesh.polygons.foreach_get("material_index", slots)
    return gather(np.maximum(slots, 0), topology.polygons)


def _add_attributes(
    context: ExportContext,
    mesh: bpy.types.Mesh,
    owner: bpy.types.Object,
    request: AttributeRequest,
    topology: Topology,
    exported: Mesh,
) -> None:
    for layer in mesh.uv_layers:
        exported.attributes[layer.name] = Attribute("CORNER", gather(read_uv_map(mesh, layer), topology.corners))
        if layer.active_render:
            exported.default_uv = layer.name
    index = mesh.color_attributes.render_color_index
    if 0 <= index < len(mesh.color_attributes):
        exported.default_color = mesh.color_attributes[index].name
    for name in sorted(name or exported.default_color for name in request.names):
        if name and name not in exported.attributes:
            attribute = read_attribute(mesh, name, topology)
            if attribute is not None:
                exported.attributes[name] = attribute
    for name in sorted(request.tangents):
        uv = exported.attributes.get(name or exported.default_uv)
        if uv is not None and uv.data.shape[1] == 2:
            context.check_cancel()
            exported.attributes[f"{name}.tangent"] = compute_tangents(exported, uv.data)
    if request.generated and len(owner.modifiers) > 0:
        _add_undeformed(mesh, exported)


def _add_undeformed(mesh: bpy.types.Mesh, exported: Mesh) -> None:
    """Where modifiers moved vertices, Blender remembers where they were before (for final renders)."""
    undeformed = np.empty(len(mesh.vertices) * 3, np.float32)
    mesh.vertices.foreach_get("undeformed_co", undeformed)
    moved = np.abs(undeformed - exported.vertices.reshape(-1)).max(initial=0.0)
    # Blender stores them relative to the texture space: what is left of rounding is no deformation.
    if not moved <= 1e-5 * np.abs(undeformed).max(initial=0.0):
        exported.attributes[UNDEFORMED] = Attribute("POINT", undeformed.reshape(-1, 3))
