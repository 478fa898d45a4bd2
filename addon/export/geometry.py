# SPDX-License-Identifier: GPL-3.0-or-later
"""Evaluated meshes to arrays of triangles."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import bpy
import numpy as np

from engine.array_types import Int32Array
from engine.scene.attribute_names import FANS, SMOOTH, UNDEFORMED, VERTEX_NORMALS
from engine.scene.content import same_content
from engine.scene.description import Attribute, Mesh
from engine.scene.tangents import compute_tangents

from ..versions import NORMALS_STOP_AT_FLAT_FACES, is_since
from .attributes import read_attribute, read_uv_map
from .context import CachedMesh, ExportContext
from .fans import read_fans
from .materials import AttributeRequest
from .normals import has_normals_of_corners, read_flat_triangles, read_normals, read_vertex_normals
from .positions import read_positions, read_undeformed
from .standard_attributes import is_hidden, is_standard, read_standard
from .topology import Topology, gather, read_topology


def export_mesh(
    context: ExportContext,
    mesh: bpy.types.Mesh,
    owner: bpy.types.Object,
    request: AttributeRequest,
    vertex_groups: tuple[str, ...] = (),
) -> Mesh | None:
    """The triangles of an evaluated mesh; None if it has none.

    A mesh equal to the one last exported from the same place is that very object again.

    Parameters
    ----------
    owner : Object
        Whose evaluation made the mesh.
    vertex_groups : tuple of str
        Names of the mesh's vertex groups, which only an object that has the mesh knows.
    """
    read = partial(_read_mesh, context, mesh, request, vertex_groups)
    if mesh.is_editmode:
        read = partial(_read_edited, context, owner, request, vertex_groups)
    return export_kept(context, owner, mesh.name_full, request, read)


def export_kept(
    context: ExportContext, owner: bpy.types.Object, name: str, request: AttributeRequest,
    read: Callable[[], Mesh | None],
) -> Mesh | None:
    """What `read` makes of a datablock, or where that is equal, what was last made of it.

    Parameters
    ----------
    owner : Object
        Whose evaluation made the datablock.
    name : str
        Of the datablock, full.
    """
    original = owner.original
    names = (original.name_full, name)
    number = context.mesh_counts[names] = context.mesh_counts.get(names, -1) + 1
    identity = (*names, number)
    kept = context.cache.meshes.get(identity)
    diced = context.diced.get(original.as_pointer()) if request.displaces else None
    is_diced_alike = diced is None or (kept is not None and kept.mesh.dicing is diced)
    if is_diced_alike and kept is not None and kept.request == request and _is_untouched(context, original):
        kept.last_used = context.cache.export_count
        return kept.mesh
    exported = read()
    if exported is None:
        context.cache.meshes.pop(identity, None)
        return None
    if diced is not None:
        exported.dicing = diced
        # Cycles splits no mesh that it divides itself.
        exported.attributes.pop(FANS, None)
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
    if a.attributes.keys() != b.attributes.keys() or not same_content(a.dicing, b.dicing):
        return False
    pairs: list[tuple[np.ndarray | None, np.ndarray | None]] = [
        (a.vertices, b.vertices),
        (a.triangles, b.triangles),
        (a.corner_normals, b.corner_normals),
        (a.material_slots, b.material_slots),
        (a.texture_space, b.texture_space),
    ]
    if a.rounds is not None or b.rounds is not None:
        if a.rounds is None or b.rounds is None:
            return False
        if (a.rounds.shape, a.rounds.subdivisions) != (b.rounds.shape, b.rounds.subdivisions):
            return False
        pairs.append((a.rounds.radii, b.rounds.radii))
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


def _read_edited(
    context: ExportContext, owner: bpy.types.Object, request: AttributeRequest, vertex_groups: tuple[str, ...]
) -> Mesh | None:
    """The mesh of an object in Edit Mode: the datablock has no UVs or is empty, only a copy has all."""
    # With arguments it would come with the modifiers that Object Mode shows.
    mesh = owner.to_mesh()
    try:
        return None if mesh is None else _read_mesh(context, mesh, request, vertex_groups)
    finally:
        owner.to_mesh_clear()


def _read_mesh(
    context: ExportContext, mesh: bpy.types.Mesh, request: AttributeRequest, vertex_groups: tuple[str, ...]
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
    exported.texture_space = np.array([mesh.texspace_location, mesh.texspace_size], np.float32)
    _add_attributes(context, mesh, request, vertex_groups, topology, exported)
    if request.displaces:
        _add_normals(mesh, topology, exported)
    return exported


def _add_normals(mesh: bpy.types.Mesh, topology: Topology, exported: Mesh) -> None:
    """What normals of a mesh that is to be displaced are made of."""
    if not has_normals_of_corners(mesh):
        exported.attributes[VERTEX_NORMALS] = Attribute("POINT", read_vertex_normals(mesh))
    elif not is_since(NORMALS_STOP_AT_FLAT_FACES):
        fans = read_fans(mesh)
        if fans is not None:
            exported.attributes[FANS] = Attribute("CORNER", gather(fans, topology.corners)[:, None])
    if exported.corner_normals is not None:
        is_smooth = ~read_flat_triangles(mesh, topology)
        exported.attributes[SMOOTH] = Attribute("FACE", is_smooth.astype(np.float32)[:, None])


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
    request: AttributeRequest,
    vertex_groups: tuple[str, ...],
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
        if not name or name in exported.attributes:
            continue
        context.check_cancel()
        if is_standard(name):
            attribute = read_standard(mesh, name, topology, vertex_groups, exported)
        elif is_hidden(name) and name != exported.default_color:
            continue
        else:
            attribute = read_attribute(mesh, name, topology, vertex_groups)
        if attribute is not None:
            exported.attributes[name] = attribute
    for name in sorted(request.tangents):
        uv = exported.attributes.get(name or exported.default_uv)
        if uv is not None and uv.data.shape[1] == 2:
            context.check_cancel()
            is_flat = read_flat_triangles(mesh, topology)
            exported.attributes[f"{name}.tangent"] = compute_tangents(exported, uv.data, is_flat)
    if request.generated:
        _add_undeformed(context, mesh, exported)


def _add_undeformed(context: ExportContext, mesh: bpy.types.Mesh, exported: Mesh) -> None:
    """Where vertices were before deformation.

    Vertices that are not deformed are added too, where they are: a place within the mesh that is found back from
    world's space is off by rounding, so that patterns of cells speckle on faces that lie between two cells.
    """
    undeformed = read_undeformed(mesh)
    moved = np.abs(undeformed - exported.vertices).max(initial=0.0)
    # Blender stores them relative to the texture space: what is left of rounding is no deformation.
    is_deformed = context.is_blurred or not moved <= 1e-5 * np.abs(undeformed).max(initial=0.0)
    exported.attributes[UNDEFORMED] = Attribute("POINT", undeformed if is_deformed else exported.vertices)
