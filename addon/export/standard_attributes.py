# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that Blender does not list among a mesh's, and that Attribute nodes name: Cycles makes them, or groups of
vertices have them."""

from __future__ import annotations

import re

import bpy
import numpy as np

from engine.array_types import Float32Array
from engine.scene.description import Attribute, Mesh

from ..versions import NORMALS_STOP_AT_FLAT_FACES, is_since
from .attributes import read_attribute
from .context import ExportContext
from .normals import has_normals_of_corners, read_corner_normals, read_tangent_normals, read_vertex_normals
from .tangents import compute_tangents
from .topology import Topology, gather

#: 'UVMap.tangent', or 'tangent' of the active map. Before displacement it is the same: no material displaces here.
_TANGENT = re.compile(r"(?:(?P<map>.+)\.)?(?:undisplaced_)?tangent(?P<sign>_sign)?")
#: Attributes of Cycles' own that are not there.
_MISSING = frozenset({"pointiness", "random_per_island"})


def read_vertex_group(mesh: bpy.types.Mesh, owner: bpy.types.Object, name: str) -> Attribute | None:
    """Weights of a group of vertices, 0 outside of it; None if there is no such group."""
    group = owner.vertex_groups.get(name)
    if group is None:
        return None
    wanted = group.index
    weights = np.zeros((len(mesh.vertices), 1), np.float32)
    for row, vertex in enumerate(mesh.vertices):
        for member in vertex.groups:
            if member.group == wanted:
                weights[row] = member.weight
    return Attribute("POINT", weights)


def make_standard(
    context: ExportContext, mesh: bpy.types.Mesh, owner: bpy.types.Object, topology: Topology, exported: Mesh, name: str
) -> Attribute | None:
    """What Cycles makes under a name of its own, None if it makes nothing; `exported` has its UV maps by now."""
    if name == "uv":
        return exported.attributes.get(exported.default_uv)
    if name == "vertex_color":
        return read_attribute(mesh, exported.default_color, topology) if exported.default_color else None
    if name == "N":
        if has_normals_of_corners(mesh) and not is_since(NORMALS_STOP_AT_FLAT_FACES):
            return Attribute("CORNER", gather(read_corner_normals(mesh), topology.corners))
        return Attribute("POINT", read_vertex_normals(mesh))
    if name == "generated":
        return Attribute("POINT", _generated(mesh, owner, exported))
    if name in _MISSING:
        context.notice(owner.name, f"attribute {name!r} is not supported", "0")
    tangent = _TANGENT.fullmatch(name)
    uv = exported.attributes.get(tangent["map"] or exported.default_uv) if tangent else None
    if uv is None or uv.data.shape[1] != 2:
        return None
    made = compute_tangents(exported, uv.data, read_tangent_normals(mesh, topology, exported)).data
    return Attribute("CORNER", np.ascontiguousarray(made[:, 3:] if tangent and tangent["sign"] else made[:, :3]))


def _generated(mesh: bpy.types.Mesh, owner: bpy.types.Object, exported: Mesh) -> Float32Array:
    """Where vertices are in the texture space, before modifiers moved them."""
    points = exported.vertices
    location, size = np.array(mesh.texspace_location, np.float32), np.array(mesh.texspace_size, np.float32)
    if len(owner.modifiers) > 0:
        flat = np.empty(len(mesh.vertices) * 3, np.float32)
        mesh.vertices.foreach_get("undeformed_co", flat)
        points = flat.reshape(-1, 3)
    half = np.where(size == 0.0, np.float32(1.0), size)
    return ((points - location + half) / (np.float32(2.0) * half)).astype(np.float32)
