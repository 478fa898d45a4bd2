# SPDX-License-Identifier: GPL-3.0-or-later
"""Normals that Attribute nodes read by the name N, in the space that Cycles has them in.

Cycles moves meshes that one object alone has into the world before it renders
(`ObjectManager::apply_static_transforms`). From Blender 5.2 on N is what it traces by, so it is in the world's space.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.scene.description import Attribute, Link, Material, Mesh, SceneDescription

from ..versions import NORMALS_AS_ATTRIBUTES, is_since
from .context import ExportContext
from .instances import Appearance

_NORMALS = "standard:N"


def move_normals(
    context: ExportContext, description: SceneDescription, kinds: list[Appearance], mesh_of: np.ndarray,
    kind_of: np.ndarray,
) -> None:
    """Put N of meshes that Cycles moves into the world into the world's space.

    Parameters
    ----------
    mesh_of, kind_of : int32 (N,)
        Of each instance, also of those that motion has left out: its mesh, and which of `kinds` it is shown as.
    """
    # Windows move objects without building their meshes again.
    if context.window is not None or not is_since(NORMALS_AS_ATTRIBUTES):
        return
    instances = description.instances
    for number, mesh in enumerate(description.meshes):
        if _NORMALS not in mesh.attributes or mesh.dicing is not None:
            continue
        users, rows = np.flatnonzero(mesh_of == number), np.flatnonzero(instances.mesh == number)
        if len(users) != 1 or len(rows) != 1:
            continue
        kind = kinds[kind_of[users[0]]]
        used = [description.materials[index] for index in kind.materials if index >= 0]
        moves = context.is_blurred and int(rows[0]) in instances.motion
        is_divided = kind.owner.original.as_pointer() in context.subdivision_levels
        if not (moves or is_divided or any(_stays(material) for material in used)):
            description.meshes[number] = _in_world(mesh, instances.transform[rows[0]])


def _stays(material: Material) -> bool:
    """Whether Cycles leaves what has a material where it is: it is displaced, or light walks below its surface."""
    if material.displacement_method != "BUMP":
        return material.graph is not None and material.graph.displacement is not None
    for node in () if material.graph is None else material.graph.nodes:
        weight = node.inputs.get("Subsurface Weight", 0.0)
        if node.kind == "ShaderNodeSubsurfaceScattering" or isinstance(weight, Link) or weight > 0.0:
            return True
    return False


def _in_world(mesh: Mesh, transform: np.ndarray) -> Mesh:
    """The mesh with unit normals in the world's space; those of mirrored objects are not turned around."""
    normals = mesh.attributes[_NORMALS]
    matrix = np.linalg.inv(transform[:3, :3].astype(np.float64))
    moved = normals.data.astype(np.float64) @ matrix
    moved /= np.maximum(np.linalg.norm(moved, axis=1, keepdims=True), 1e-30)
    attributes = {**mesh.attributes, _NORMALS: Attribute(normals.domain, moved.astype(np.float32))}
    return replace(mesh, key=(mesh.key, "normals in the world", transform.tobytes()), attributes=attributes)
