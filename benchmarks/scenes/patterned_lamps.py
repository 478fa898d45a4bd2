# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose nodes give another emission at every point, seen by the camera and in surfaces that reflect."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, light, material, show, stage, world


def _shine(lamp: Any, pattern: Callable[[Nodes], Socket]) -> None:
    """Give a lamp the emission that `pattern` says."""
    lamp.data.use_nodes = True
    nodes = Nodes(lamp.data.node_tree)
    nodes.node("OutputLight", Surface=pattern(nodes))


def _checked(nodes: Nodes) -> Socket:
    place = nodes("NewGeometry", output="Parametric")
    checker = nodes("TexChecker", Vector=place, Color1=(1.0, 0.2, 0.1), Color2=(0.1, 0.4, 1.0), Scale=4.0)
    return nodes("Emission", Color=checker, Strength=1.0)


def _banded(nodes: Nodes) -> Socket:
    wave = nodes("TexWave", Vector=nodes("NewGeometry", output="Normal"), Scale=2.0)
    return nodes("Emission", Color=wave, Strength=1.5)


def _lamps() -> None:
    stage()
    world((0.02, 0.02, 0.03))
    _shine(light("AREA", 150.0, (0.0, 2.0, 2.2), (0, 0, 0.4), size=1.4), _checked)
    ball = light("POINT", 80.0, (-1.6, -0.6, 2.2), shadow_soft_size=0.45, use_soft_falloff=False)
    _shine(ball, _banded)


@scene("lamp-patterns")
def patterns() -> None:
    """A checked area lamp and a banded ball, in sight and in glossy surfaces, by direct light."""
    _lamps()
    bpy.context.scene.cycles.max_bounces = 0
    show(material("glossy", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.3)))


@scene("lamp-patterns-mirror")
def patterns_mirror() -> None:
    """The same in mirrors, which light samples do not reach, on a diffuse floor."""
    _lamps()
    bpy.context.scene.cycles.max_bounces = 1
    bpy.context.scene.cycles.caustics_reflective = False
    show(material("mirror", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.0)))
