# SPDX-License-Identifier: GPL-3.0-or-later
"""Glass that is rougher along one direction than across it, from Blender 5.3 on; before, as rough in all directions."""

from __future__ import annotations

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, lit_stage, material, quad


def _of_node(nodes: Nodes) -> Socket:
    """The Glass BSDF, as anisotropic as its Blender has it."""
    made = nodes("BsdfGlass", {"distribution": "MULTI_GGX"}, Color=(0.9, 0.95, 1.0), Roughness=0.35)
    if "Anisotropy" in made.node.inputs:
        made.node.inputs["Anisotropy"].default_value = 0.7
        made.node.inputs["Rotation"].default_value = 0.1
        tangent = nodes("Tangent", {"direction_type": "UV_MAP"})
        made.id_data.links.new(tangent, made.node.inputs["Tangent"])
    return made


def _principled(nodes: Nodes) -> Socket:
    """Glass of the Principled BSDF."""
    tangent = nodes("Tangent", {"direction_type": "UV_MAP"})
    inputs = {"Base Color": (1.0, 0.9, 0.8, 1.0), "Transmission Weight": 1.0, "Anisotropic": 0.9, "Tangent": tangent}
    return nodes("BsdfPrincipled", Roughness=0.35, **inputs)


@scene("glass-anisotropic", samples=128)
def glass_anisotropic() -> None:
    """Panes of anisotropic glass before walls, of the Glass and of the Principled BSDF."""
    lit_stage()
    bpy.context.scene.cycles.caustics_refractive = False
    for name, surface, x in (("node", _of_node, -1.3), ("principled", _principled, 1.3)):
        add_object(name, quad(name, material(name, surface), 1.8, 1.6), (x, -0.6, 0.9), (80.0, 0.0, 0.0))
