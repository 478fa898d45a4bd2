# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes of older Blenders as those of 5.2, with the adjustments Blender makes to such a file on loading it."""

from __future__ import annotations

from typing import Any

from engine.scene.description import Link, Node

from ..versions import Version, is_since

#: Principled BSDF before 4.0.
_PRINCIPLED_INPUTS = {
    "Subsurface": "Subsurface Weight",
    "Specular": "Specular IOR Level",
    "Transmission": "Transmission Weight",
    "Clearcoat": "Coat Weight",
    "Clearcoat Roughness": "Coat Roughness",
    "Clearcoat Normal": "Coat Normal",
    "Sheen": "Sheen Weight",
    "Emission": "Emission Color",
}

#: Inputs of Principled BSDF that older versions lack, with the value that changes nothing.
_PRINCIPLED_DEFAULTS: dict[str, Any] = {
    "Diffuse Roughness": 0.0,
    "Coat Tint": (1.0, 1.0, 1.0, 1.0),
    "Sheen Roughness": 0.5,
    "Thin Film Thickness": 0.0,
    "Thin Film IOR": 1.33,
}

_WHITE = (1.0, 1.0, 1.0, 1.0)

#: Kinds that another kind replaced: new kind, properties, input names, output names.
_REPLACED: dict[str, tuple[str, dict[str, Any], dict[str, str], dict[str, str]]] = {
    "ShaderNodeSeparateRGB": (
        "ShaderNodeSeparateColor",
        {"mode": "RGB"},
        {"Image": "Color"},
        {"R": "Red", "G": "Green", "B": "Blue"},
    ),
    "ShaderNodeSeparateHSV": (
        "ShaderNodeSeparateColor",
        {"mode": "HSV"},
        {},
        {"H": "Red", "S": "Green", "V": "Blue"},
    ),
    "ShaderNodeCombineRGB": (
        "ShaderNodeCombineColor",
        {"mode": "RGB"},
        {"R": "Red", "G": "Green", "B": "Blue"},
        {"Image": "Color"},
    ),
    "ShaderNodeCombineHSV": (
        "ShaderNodeCombineColor",
        {"mode": "HSV"},
        {"H": "Red", "S": "Green", "V": "Blue"},
        {},
    ),
    "ShaderNodeBsdfVelvet": ("ShaderNodeBsdfSheen", {"distribution": "ASHIKHMIN"}, {"Sigma": "Roughness"}, {}),
}


#: What nodes lack in older Blenders: settings and inputs, with the value they have there.
_ADDED: dict[str, tuple[dict[str, Any], dict[str, Any]]] = {
    "ShaderNodeBsdfAnisotropic": ({}, {"Anisotropy": 0.0, "Rotation": 0.0}),
    "ShaderNodeBump": ({}, {"Filter Width": 1.0}),
    "ShaderNodeTexNoise": ({"noise_type": "FBM", "normalize": True}, {"Lacunarity": 2.0}),
    "ShaderNodeTexVoronoi": ({"normalize": False}, {"Detail": 0.0, "Roughness": 0.5, "Lacunarity": 2.0}),
}

#: What nodes do otherwise than in older Blenders, without a setting of their own for it: a property that the engine
#: reads, and the first version for which it is true.
_CHANGED: dict[str, tuple[str, Version]] = {
    # Before, light that facets scatter repeatedly had the colour once more.
    "ShaderNodeBsdfDiffuse": ("tints_by_bounce", (5, 3)),
    "ShaderNodeBsdfPrincipled": ("tints_by_bounce", (5, 3)),
    # Before, the normal between those of the corners was not normalised.
    "ShaderNodeNormalMap": ("has_unit_frame", (5, 1)),
    # Before, coordinates were wrapped first and scaled then.
    "ShaderNodeTexMagic": ("wraps_scaled", (5, 2)),
}

#: Settings of subsurface scattering: since 5.2 a random walk is another, and the old one has another name.
_WALKS = {"ShaderNodeSubsurfaceScattering": "falloff", "ShaderNodeBsdfPrincipled": "subsurface_method"}
_NEW_WALKS: Version = (5, 2)


def modernize(node: Node, index: int) -> list[Node]:
    """`node` in the terms of Blender 5.2, last in a list with whatever it needs before it.

    Parameters
    ----------
    index : int
        Where the first node of the list will stand in the graph.
    """
    if node.kind in _REPLACED:
        kind, properties, inputs, outputs = _REPLACED[node.kind]
        node.kind = kind
        node.properties.update(properties)
        node.inputs = {inputs.get(name, name): value for name, value in node.inputs.items()}
        if outputs:
            node.properties["renamed_outputs"] = outputs
    if node.kind == "ShaderNodeBsdfPrincipled" and "Clearcoat" in node.inputs:
        return _principled(node, index)
    if node.kind == "ShaderNodeBsdfGlossy":
        node.kind = "ShaderNodeBsdfAnisotropic"
    if node.properties.get("distribution") == "SHARP":
        node.properties["distribution"] = "GGX"
        node.inputs["Roughness"] = 0.0
    added_properties, added_inputs = _ADDED.get(node.kind, ({}, {}))
    node.properties = added_properties | node.properties
    node.inputs = added_inputs | node.inputs
    if node.kind in _CHANGED:
        name, since = _CHANGED[node.kind]
        node.properties[name] = is_since(since)
    before = []
    if node.kind in _WALKS and not is_since(_NEW_WALKS):
        before = _walk_as_before(node, index)
    if node.kind == "ShaderNodeTexSky" and "dust_density" in node.properties:
        node.properties["aerosol_density"] = node.properties.pop("dust_density")
        if node.properties.get("sky_type") == "NISHITA":
            node.properties["sky_type"] = "SINGLE_SCATTERING"
    return [*before, node]


def _walk_as_before(node: Node, index: int) -> list[Node]:
    """Make a node's subsurface scattering that of Blender before 5.2; returns what has to stand before it."""
    if node.properties.get(_WALKS[node.kind]) == "RANDOM_WALK":
        node.properties[_WALKS[node.kind]] = "RANDOM_WALK_LEGACY"
    # Backward scattering counted as even.
    name = "Anisotropy" if node.kind == "ShaderNodeSubsurfaceScattering" else "Subsurface Anisotropy"
    anisotropy = node.inputs.get(name)
    if not isinstance(anisotropy, Link):
        if anisotropy is not None:
            node.inputs[name] = max(anisotropy, 0.0)
        return []
    node.inputs[name] = Link(index, "Value")
    inputs = {"Value": anisotropy, "Value_001": 0.0}
    return [Node("ShaderNodeMath", node.name, inputs, {"operation": "MAXIMUM"})]


def _principled(node: Node, index: int) -> list[Node]:
    """Blender 3's Principled BSDF: see `version_principled_bsdf_*` of Blender's loader for the factors."""
    old = node.inputs
    before: list[Node] = []

    def mix(factor: Any, a: Any, b: Any) -> Any:
        if not any(isinstance(value, Link) for value in (factor, a, b)):
            return tuple(x + (y - x) * factor for x, y in zip(a, b, strict=True))
        before.append(
            Node(
                "ShaderNodeMix",
                node.name,
                {"Factor_Float": factor, "A_Color": a, "B_Color": b},
                {
                    "data_type": "RGBA",
                    "blend_type": "MIX",
                    "factor_mode": "UNIFORM",
                    "clamp_factor": True,
                    "clamp_result": False,
                },
            )
        )
        return Link(index + len(before) - 1, "Result_Color")

    new = {_PRINCIPLED_INPUTS.get(name, name): value for name, value in old.items()}
    for name in ("Subsurface Color", "Transmission Roughness"):
        new.pop(name, None)
    for name, value in _PRINCIPLED_DEFAULTS.items():
        new.setdefault(name, value)

    coat_is_linked = isinstance(old["Clearcoat"], Link)
    new["Coat IOR"] = 1.2 if coat_is_linked else 1.5
    if not coat_is_linked:
        new["Coat Weight"] = 0.25 * old["Clearcoat"]

    sheen_is_linked = isinstance(old["Sheen"], Link)
    new["Sheen Tint"] = (0.2, 0.2, 0.2, 1.0) if sheen_is_linked else _WHITE
    if not sheen_is_linked:
        new["Sheen Weight"] = 0.2 * old["Sheen"]

    new["Subsurface Scale"] = 0.05
    if old["Subsurface"] != 0.0:
        new["Base Color"] = mix(old["Subsurface"], old["Base Color"], old["Subsurface Color"])
        new["Subsurface Scale"] = old["Subsurface"]
        new["Subsurface Weight"] = 1.0

    tint = old["Specular Tint"]
    new["Specular Tint"] = _WHITE if tint == 0.0 else mix(tint, _WHITE, new["Base Color"])
    node.inputs = new
    return [*before, node]
