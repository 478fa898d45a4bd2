# SPDX-License-Identifier: GPL-3.0-or-later
"""Attributes that Cycles has under names of its own, and that Attribute nodes read by them: 'uv', 'N', 'tangent'.

Cycles makes them of a mesh's shape and of what it shows by default. In graphs of nodes and in `Mesh.attributes` they
are called 'standard:uv'. Before Blender 5.3 materials do not see an attribute of the same name that a mesh has itself.
"""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Attribute, Mesh
from engine.scene.tangents import compute_tangents

from ..versions import NORMALS_AS_ATTRIBUTES, OWN_ATTRIBUTES_FIRST, is_since
from .attributes import read_attribute
from .mesh_shape import pointiness, random_per_island
from .normals import has_normals_of_corners, read_corner_normals, read_flat_triangles, read_vertex_normals
from .positions import read_undeformed
from .topology import Topology, gather

_PREFIX = "standard:"

#: Made of the shape, whatever attributes a mesh has.
_OF_SHAPE = frozenset({"generated", "N", "pointiness", "random_per_island", "generated_transform"})

#: Endings of names, and whether they are the sign of the bitangent. Without displacement all tangents are alike.
_TANGENTS = {
    "undisplaced_tangent_sign": True,
    "undisplaced_tangent": False,
    "tangent_sign": True,
    "tangent": False,
}

#: Cycles has them in meshes (undisplaced ones if these are displaced).
_OF_MESHES = _OF_SHAPE | _TANGENTS.keys() | {"uv", "vertex_color", "undisplaced", "undisplaced_N"}

#: Cycles has them elsewhere: in volumes, hair and particles.
_ELSEWHERE = frozenset({
    "undeformed", "particle", "curve_intercept", "curve_length", "curve_random", "point_random", "ptex_face_id",
    "ptex_uv", "density", "color", "flame", "heat", "temperature", "velocity", "velocity_x", "velocity_y", "velocity_z",
    "shadow_transparency",
})  # fmt: skip

#: What is not read, and is 0.
UNREAD = frozenset({"generated_transform"})


def attribute_name(name: str) -> str:
    """What graphs of nodes call the attribute that an Attribute node names."""
    is_tangent = any(name.endswith(f".{ending}") for ending in _TANGENTS)
    return f"{_PREFIX}{name}" if name in _OF_MESHES or is_tangent else name


def is_standard(name: str) -> bool:
    """Whether `attribute_name` gave this name to what Cycles makes itself."""
    return name.startswith(_PREFIX)


def is_hidden(name: str) -> bool:
    """Whether Cycles does not look for this name among a mesh's own attributes."""
    is_taken = name in _ELSEWHERE or name in ("P", "radius") and is_since(NORMALS_AS_ATTRIBUTES)
    return is_taken and not is_since(OWN_ATTRIBUTES_FIRST)


def read_standard(
    mesh: bpy.types.Mesh, standard: str, topology: Topology, vertex_groups: tuple[str, ...], exported: Mesh
) -> Attribute | None:
    """What is behind a name of `attribute_name`; None if the mesh has none.

    Parameters
    ----------
    mesh : Mesh
        Evaluated.
    vertex_groups : tuple of str
        Names of the mesh's vertex groups.
    exported : Mesh
        The same as far as it is exported: shape, texture space, UV maps.
    """
    name = standard.removeprefix(_PREFIX)
    if name not in _OF_SHAPE and is_since(OWN_ATTRIBUTES_FIRST):
        own = read_attribute(mesh, name, topology, vertex_groups)
        if own is not None:
            return own
    base, _, ending = name.rpartition(".")
    if base:
        if base in mesh.uv_layers:
            return _tangents(exported, exported.attributes[base].data, read_flat_triangles(mesh, topology), ending)
        return read_attribute(mesh, name, topology, vertex_groups)
    if name in _TANGENTS:
        uv = exported.attributes.get(exported.default_uv)
        uvs = _on_sphere(exported) if uv is None else uv.data
        return _tangents(exported, uvs, read_flat_triangles(mesh, topology), name)
    if name == "uv":
        return exported.attributes.get(exported.default_uv)
    if name == "vertex_color":
        return read_attribute(mesh, exported.default_color, topology) if exported.default_color else None
    if name == "generated":
        return Attribute("POINT", _generated(mesh, exported))
    if name == "N":
        return _normals(mesh, topology)
    if name == "pointiness":
        return Attribute("POINT", pointiness(mesh))
    if name == "random_per_island":
        return Attribute("FACE", random_per_island(mesh, topology))
    return None


def _tangents(exported: Mesh, uv: Float32Array, is_flat: npt.NDArray[np.bool_], ending: str) -> Attribute:
    tangents = compute_tangents(exported, uv, is_flat).data
    return Attribute("CORNER", np.ascontiguousarray(tangents[:, 3:] if _TANGENTS[ending] else tangents[:, :3]))


def _on_sphere(exported: Mesh) -> Float32Array:
    """UV coordinates of corners of a mesh without a UV map: the directions of vertices, as Cycles maps them."""
    x, y, z = exported.vertices[exported.triangles.reshape(-1)].astype(np.float64).T
    length = np.sqrt(x * x + y * y + z * z)
    u = np.where((x == 0.0) & (y == 0.0), 0.0, 0.5 - np.arctan2(x, y) / (2.0 * np.pi))
    v = 1.0 - np.arccos(np.clip(z / np.maximum(length, 1e-30), -1.0, 1.0)) / np.pi
    return (np.stack([u, v], axis=1) * (length > 0.0)[:, None]).astype(np.float32)


def _generated(mesh: bpy.types.Mesh, exported: Mesh) -> Float32Array:
    """Places of vertices in the texture space before deformation, float32 (V, 3); the middle where that is flat."""
    assert exported.texture_space is not None
    center, half = exported.texture_space
    offsets = read_undeformed(mesh) - center
    return 0.5 + 0.5 * np.divide(offsets, half, out=np.zeros_like(offsets), where=half != 0.0)


def _normals(mesh: bpy.types.Mesh, topology: Topology) -> Attribute | None:
    """Normals in the object's own space; those of vertices on flat faces too."""
    if not has_normals_of_corners(mesh):
        return Attribute("POINT", read_vertex_normals(mesh))
    if is_since(NORMALS_AS_ATTRIBUTES) and not is_since(OWN_ATTRIBUTES_FIRST):
        return None
    return Attribute("CORNER", gather(read_corner_normals(mesh), topology.corners))
