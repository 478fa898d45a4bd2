# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures that few scenes have, each on a sphere and a box on the lit stage."""

from __future__ import annotations

from collections.abc import Callable

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, Surface, lit_stage, material, show

_FILM = {"Thin Film Thickness": 420.0, "Thin Film IOR": 1.33}
_COPPER = {"IOR": (0.27, 0.68, 1.32), "Extinction": (3.61, 2.63, 2.29)}


def _shown(name: str, note: str = "", allowance: float = 0.0, samples: int = 64) -> Callable[[Surface], Surface]:
    """Register `show(material(surface))` on the lit stage."""

    def register(surface: Surface) -> Surface:
        def builder() -> None:
            lit_stage()
            show(material(name, surface))

        builder.__doc__ = surface.__doc__
        scene(name, samples, note, allowance, module=surface.__module__)(builder)
        return surface

    return register


@_shown("glossy-ashikhmin-shirley")
def glossy_ashikhmin_shirley(nodes: Nodes) -> Socket:
    """Ashikhmin and Shirley's glossy reflection."""
    return nodes("BsdfAnisotropic", {"distribution": "ASHIKHMIN_SHIRLEY"}, Color=(0.9, 0.8, 0.6), Roughness=0.3)


@_shown("glass-beckmann", "Cycles' light sampling adds light for impossible refractions", 0.01, samples=128)
def glass_beckmann(nodes: Nodes) -> Socket:
    """Glass of Beckmann's facets."""
    return nodes("BsdfGlass", {"distribution": "BECKMANN"}, Color=(0.9, 0.95, 1.0), Roughness=0.25, IOR=1.45)


@_shown("principled-film")
def principled_film(nodes: Nodes) -> Socket:
    """A thin film over plastic and metal."""
    inputs = {"Base Color": (0.5, 0.3, 0.6), "Metallic": 0.5, "Roughness": 0.3, **_FILM}
    return nodes("BsdfPrincipled", {}, inputs)


@_shown("glass-film", "Cycles' light sampling adds light for impossible refractions", 0.01, samples=128)
def glass_film(nodes: Nodes) -> Socket:
    """A thin film on glass."""
    return nodes("BsdfGlass", {}, {"Color": (1.0, 1.0, 1.0), "Roughness": 0.1, "IOR": 1.5, **_FILM})


@_shown("metal-by-index")
def metal_by_index(nodes: Nodes) -> Socket:
    """Copper by n and k."""
    return nodes("BsdfMetallic", {"fresnel_type": "PHYSICAL_CONDUCTOR"}, {"Roughness": 0.3, **_COPPER})


@_shown("toon-and-velvet")
def toon_and_velvet(nodes: Nodes) -> Socket:
    """Both Toon BSDFs, and Ashikhmin's sheen over them."""
    toon = nodes("BsdfToon", {"component": "DIFFUSE"}, Color=(0.4, 0.2, 0.1), Size=0.6, Smooth=0.2)
    shine = nodes("BsdfToon", {"component": "GLOSSY"}, Color=(0.2, 0.3, 0.2), Size=0.3, Smooth=0.1)
    velvet = nodes("BsdfSheen", {"distribution": "ASHIKHMIN"}, Color=(0.1, 0.2, 0.4), Roughness=0.5)
    return nodes("AddShader", {}, {0: nodes("AddShader", {}, {0: toon, 1: shine}), 1: velvet})
