# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene per layer of the Principled BSDF."""

from __future__ import annotations

from typing import Any

from benchmarks.scenes.closures import ROUGH_REFRACTION, closure_scene
from benchmarks.scenes.studio import Nodes, Socket

BASE: dict[str, Any] = {"Base_Color": (0.7, 0.35, 0.2), "Roughness": 0.5}

#: Inputs that differ from the node's defaults, by scene; the rest of the name says which layer it is about.
LAYERS: dict[str, tuple[dict[str, Any], str]] = {
    "dielectric": ({}, "Default dielectric over diffuse."),
    "dielectric-smooth": ({"Roughness": 0.1}, "Polished dielectric over diffuse."),
    "dielectric-mirror": ({"Roughness": 0.0}, "Dielectric coat of roughness 0."),
    "diffuse-rough": ({"Roughness": 0.9, "Diffuse_Roughness": 1.0}, "Rough diffuse base under a rough dielectric."),
    "ior": ({"IOR": 2.2, "Roughness": 0.3}, "High index of refraction."),
    "specular": (
        {"Specular_IOR_Level": 0.9, "Specular_Tint": (1.0, 0.6, 0.2), "Roughness": 0.3},
        "Raised and tinted specular level.",
    ),
    "metal": ({"Metallic": 1.0, "Roughness": 0.3}, "Metal."),
    "metal-tint": ({"Metallic": 1.0, "Roughness": 0.3, "Specular_Tint": (0.2, 0.6, 1.0)}, "Metal with an edge tint."),
    "metal-mixed": ({"Metallic": 0.5, "Roughness": 0.4}, "Half metal, half dielectric."),
    "anisotropic": (
        {"Metallic": 1.0, "Roughness": 0.4, "Anisotropic": 0.8, "Anisotropic_Rotation": 0.2},
        "Brushed metal.",
    ),
    "coat": ({"Coat_Weight": 1.0, "Coat_Roughness": 0.1, "Coat_Tint": (0.9, 0.7, 0.5)}, "Tinted clear coat."),
    "sheen": ({"Sheen_Weight": 1.0, "Sheen_Roughness": 0.4, "Sheen_Tint": (0.5, 0.8, 1.0)}, "Sheen."),
    "transmission": ({"Transmission_Weight": 1.0, "Roughness": 0.0, "Base_Color": (0.9, 1.0, 0.95)}, "Clear glass."),
    "transmission-rough": (
        {"Transmission_Weight": 1.0, "Roughness": 0.4, "Base_Color": (0.9, 1.0, 0.95)},
        "Rough glass.",
    ),
    "transmission-half": ({"Transmission_Weight": 0.5, "Roughness": 0.3}, "Half transmission."),
    "emission": ({"Emission_Color": (0.3, 0.6, 1.0), "Emission_Strength": 0.7}, "Emission under the layers."),
    "alpha": ({"Alpha": 0.4}, "Partly transparent."),
    "everything": (
        {
            "Metallic": 0.3,
            "Roughness": 0.35,
            "Transmission_Weight": 0.3,
            "Coat_Weight": 0.5,
            "Sheen_Weight": 0.5,
            "Emission_Strength": 0.1,
            "Emission_Color": (1.0, 0.8, 0.6),
            "Alpha": 0.8,
        },
        "Every layer at once.",
    ),
}


def _register(name: str, inputs: dict[str, Any], description: str) -> None:
    def surface(nodes: Nodes) -> Socket:
        return nodes("BsdfPrincipled", **{**BASE, **inputs})

    surface.__doc__ = f"Principled BSDF: {description}"
    is_rough_glass = name in ("transmission-rough", "transmission-half", "everything")
    closure_scene(
        f"principled-{name}",
        samples=128 if "transmission" in name or is_rough_glass else 64,
        note=ROUGH_REFRACTION if is_rough_glass else "",
    )(surface)


for _name, (_inputs, _description) in LAYERS.items():
    _register(_name, _inputs, _description)
