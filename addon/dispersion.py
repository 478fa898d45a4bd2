# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials of Blender disperse light, and how strongly."""

from __future__ import annotations

from typing import Any

import bpy

_REFRACTING = {"ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction"}
#: Sockets of the Principled BSDF, in Blender 4 and before it.
_TRANSMISSION = ("Transmission Weight", "Transmission")


def can_disperse(material: bpy.types.Material) -> bool:
    """Whether some node of a material, or of a group in it, refracts."""
    return material.node_tree is not None and _refracts(material.node_tree, set())


def _refracts(tree: Any, seen: set[str]) -> bool:
    if tree.name in seen:
        return False
    seen.add(tree.name)
    for node in tree.nodes:
        if node.mute:
            continue
        if node.bl_idname in _REFRACTING:
            return True
        if node.bl_idname == "ShaderNodeBsdfPrincipled":
            sockets = [node.inputs[name] for name in _TRANSMISSION if name in node.inputs]
            if any(socket.is_linked or socket.default_value > 0.0 for socket in sockets):
                return True
        if node.bl_idname == "ShaderNodeGroup" and node.node_tree is not None and _refracts(node.node_tree, seen):
            return True
    return False


def dispersion_of(material: bpy.types.Material) -> float:
    """What the engine is told.

    Returns
    -------
    float  [um^2]
        `Material.dispersion` of the description; 0 for what does not refract.
    """
    # Not above: panels need no compiler.
    from engine.spectral.dispersion import dispersion_from_abbe, dispersion_from_cauchy

    chosen = getattr(material, "neuralguide", None)  # None where the add-on only exports
    if chosen is None or chosen.dispersion == "NONE" or not can_disperse(material):
        return 0.0
    if chosen.dispersion == "ABBE":
        return dispersion_from_abbe(chosen.abbe_number)
    return dispersion_from_cauchy(chosen.cauchy_a, chosen.cauchy_b)
