# SPDX-License-Identifier: GPL-3.0-or-later
"""Which materials of Blender disperse light, and how strongly.

The Principled BSDF says so itself from Blender 5.3 on, and Cycles renders that. The add-on's panel is for older
Blenders and files, and for what has no such inputs: it counts where no node of the material disperses.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from typing import Any

import bpy

from engine.scene.description import Link, Node, NodeGraph

_REFRACTING = {"ShaderNodeBsdfGlass", "ShaderNodeBsdfRefraction"}
#: Sockets of the Principled BSDF, in Blender 4 and before it.
_TRANSMISSION = ("Transmission Weight", "Transmission")


def can_disperse(material: bpy.types.Material) -> bool:
    """Whether some node of a material, or of a group in it, refracts."""
    return material.node_tree is not None and _refracts(material.node_tree, set())


def disperses_by_node(material: bpy.types.Material) -> bool:
    """Whether a Principled BSDF of the material says that it disperses light, which the panel then does not."""
    scales = (
        node.inputs.get("Transmission Dispersion Scale") for node in material.node_tree.nodes
        if node.bl_idname == "ShaderNodeBsdfPrincipled"
    )  # fmt: skip
    return any(scale is not None and (scale.is_linked or scale.default_value > 0.0) for scale in scales)


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


def dispersion_of(
    material: bpy.types.Material, graph: NodeGraph | None, notice: Callable[[str, str], None]
) -> float:
    """What the engine is told.

    Parameters
    ----------
    graph : NodeGraph or None
        Graph of the material, as exported.
    notice : function
        Told what is not as the material says: the problem, and what is shown instead.

    Returns
    -------
    float  [um^2]
        `Material.dispersion` of the description; 0 for what does not refract.
    """
    of_panel = _of_panel(material)
    of_nodes = list(_of_nodes(graph, notice)) if graph is not None else []
    strongest = max(of_nodes, default=0.0)
    if strongest == 0.0:
        return of_panel
    if of_panel not in (0.0, strongest):
        notice("its Dispersion panel is not read", "dispersion as its Principled BSDF says")
    if min(of_nodes) != strongest:
        notice("nodes that disperse differently in one material are not supported", "all as the strongest of them")
    return strongest


def _of_panel(material: bpy.types.Material) -> float:
    # Not above: panels need no compiler.
    from engine.spectral.dispersion import dispersion_from_abbe, dispersion_from_cauchy

    chosen = getattr(material, "neuralguide", None)  # None where the add-on only exports
    if chosen is None or chosen.dispersion == "NONE" or not can_disperse(material):
        return 0.0
    if chosen.dispersion == "ABBE":
        return dispersion_from_abbe(chosen.abbe_number)
    return dispersion_from_cauchy(chosen.cauchy_a, chosen.cauchy_b)


def _of_nodes(graph: NodeGraph, notice: Callable[[str, str], None]) -> Iterator[float]:
    """The dispersion of each node that refracts."""
    for node in graph.nodes:
        if node.kind in _REFRACTING:
            yield 0.0
        elif node.kind == "ShaderNodeBsdfPrincipled" and _number(graph, node, "Transmission Weight", 0.0) != 0.0:
            yield _of_principled(graph, node, notice)


def _of_principled(graph: NodeGraph, node: Node, notice: Callable[[str, str], None]) -> float:
    from engine.spectral.dispersion import dispersion_from_abbe

    scale = _number(graph, node, "Transmission Dispersion Scale", 0.0)
    if scale is not None and not scale > 0.0:
        return 0.0
    abbe_number = _number(graph, node, "Transmission Dispersion Abbe Number", 20.0)
    if scale is None or abbe_number is None:
        notice(f"dispersion of {node.name!r} that varies over the surface is not supported", "none")
        return 0.0
    # Like Cycles, which follows OpenPBR: the Abbe number that acts is the number by the scale, of at most 1.
    return dispersion_from_abbe(abbe_number / min(scale, 1.0))


def _number(graph: NodeGraph, node: Node, name: str, default: float) -> float | None:
    """An input's value, wherever on the surface; None where it varies."""
    value = node.inputs.get(name, default)
    if isinstance(value, Link):
        source = graph.nodes[value.node]
        value = source.properties.get("value") if source.kind == "ShaderNodeValue" else None
    return float(value) if isinstance(value, (int, float)) and math.isfinite(value) else None
