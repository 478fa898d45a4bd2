# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps whose nodes read the lamp's own space and its object's facts."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import bpy
from mathutils import Matrix

from benchmarks.scenes.lights import dim_stage
from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, light


def _shine(lamp: Any, pattern: Callable[[Nodes], Socket]) -> None:
    """Turn, scale and show a lamp, and give it the emission that `pattern` says."""
    lamp.data.use_nodes = True
    nodes = Nodes(lamp.data.node_tree)
    nodes.node("OutputLight", Surface=nodes("Emission", Color=pattern(nodes), Strength=1.0))
    lamp.visible_camera = True
    lamp.scale = (1.2, 0.8, 1.1)
    lamp.color = (0.9, 0.5, 0.3, 1.0)


def _checked(vector: Callable[[Nodes], Socket], scale: float) -> Callable[[Nodes], Socket]:
    def pattern(nodes: Nodes) -> Socket:
        return nodes("TexChecker", Vector=vector(nodes), Color1=(1.0, 0.2, 0.1), Color2=(0.1, 0.4, 1.0), Scale=scale)

    return pattern


def _coordinate(output: str) -> Callable[[Nodes], Socket]:
    return lambda nodes: nodes("TexCoord", output=output)


def _mapped(nodes: Nodes) -> Socket:
    settings = {"Vector": nodes("TexCoord", output="Object"), "Location": (0.1, 0.2, 0.05), "Rotation": (0.2, 0.3, 0.8)}
    return nodes("Mapping", {"vector_type": "TEXTURE"}, **settings)


def _turned(nodes: Nodes) -> Socket:
    settings = {"vector_type": "VECTOR", "convert_from": "WORLD", "convert_to": "OBJECT"}
    return nodes("VectorTransform", settings, Vector=nodes("NewGeometry", output="Incoming"))


def _of_object(nodes: Nodes) -> Socket:
    return nodes("ObjectInfo", output="Color")


@scene("lamp-patterns-local", samples=128)
def patterns_local() -> None:
    """Lamps of each kind with patterns in their own space, before the camera and in glossy surfaces."""
    dim_stage(glossy=True)
    ball = {"shadow_soft_size": 0.3, "use_soft_falloff": False}
    _shine(light("AREA", 25.0, (-1.4, 0.5, 2.1), (0, -3, 1), size=0.8), _checked(_mapped, 6.0))
    _shine(light("POINT", 25.0, (-0.6, 0.5, 2.1), (0, -3, 1), **ball), _checked(_coordinate("Normal"), 3.0))
    _shine(light("SPOT", 40.0, (0.2, 0.5, 2.1), (0, -3, 1), **ball, spot_size=2.0), _checked(_coordinate("UV"), 9.0))
    _shine(light("POINT", 25.0, (1.0, 0.5, 2.1), (0, -3, 1), **ball), _checked(_coordinate("UV"), 9.0))
    _shine(light("POINT", 25.0, (1.7, 0.5, 2.1), (0, -3, 1), shadow_soft_size=0.3), _of_object)
    _shine(light("AREA", 15.0, (-1.5, -1.5, 2.6), (0, -1, 0), shape="DISK", size=0.8), _checked(_turned, 4.0))
    sun = light("SUN", 0.4, (0, 0, 4.0), angle=math.radians(40))
    _shine(sun, _checked(_coordinate("UV"), 5.0))
    # In sight, low above the floor.
    sun.matrix_world = Matrix.Rotation(0.2, 4, "Z") @ Matrix.Rotation(math.radians(-85), 4, "X")
    bpy.context.view_layer.update()
