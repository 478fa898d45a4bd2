# SPDX-License-Identifier: GPL-3.0-or-later
"""Window coordinates where they are no perspective: of panoramas, and of a world behind an orthographic camera."""

from __future__ import annotations

import math
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, aim, box, material, show, stage, world_nodes


def _window(nodes: Nodes) -> Socket:
    """Waves over the picture, of its own coordinates, which are shown too."""
    place = nodes("TexCoord", output="Window")
    waves = nodes("TexWave", {"wave_profile": "SIN"}, Vector=place, Scale=6.0, Distortion=0.0, output="Color")
    shown = nodes("VectorMath", {"operation": "MULTIPLY_ADD"}, {0: place, 1: (0.5, 0.5, 0.0), 2: (0.2, 0.2, 0.2)})
    return nodes("VectorMath", {"operation": "MULTIPLY"}, {0: waves, 1: shown})


def _scene(kind: str) -> Any:
    """The stage with the picture's waves on sphere, box and world, and a mirror; the camera's data."""
    stage()
    show(material("window", lambda nodes: nodes("BsdfDiffuse", Color=_window(nodes))))
    mirror = material("mirror", lambda nodes: nodes("BsdfAnisotropic", {"distribution": "GGX"}, Roughness=0.0))
    add_object("Mirror", box("Mirror", mirror, (0.8, 0.1, 0.9)), (-0.2, -1.2, 0.45), (0, 0, 30))
    world_nodes(lambda nodes: nodes("Background", Color=_window(nodes), Strength=2.0))
    camera = bpy.context.scene.camera
    camera.data.type = kind
    return camera.data


@scene("window-orthographic")
def orthographic() -> None:
    """An orthographic camera before a world of its picture's coordinates."""
    data = _scene("ORTHO")
    data.ortho_scale, data.shift_y = 7.0, 0.1


@scene("window-fisheye")
def fisheye() -> None:
    """A fisheye among surfaces, and before a world, of its picture's coordinates."""
    data = _scene("PANO")
    data.panorama_type, data.fisheye_fov, data.shift_x = "FISHEYE_EQUIDISTANT", math.radians(150.0), 0.05
    camera = bpy.context.scene.camera
    camera.location = (0.3, -3.0, 1.0)
    aim(camera, (0.0, 0.0, 0.8))


@scene("window-equirectangular")
def equirectangular() -> None:
    """Part of an equirectangular panorama of its own coordinates."""
    fisheye()
    data = bpy.context.scene.camera.data
    data.panorama_type = "EQUIRECTANGULAR"
    data.latitude_min, data.longitude_max = math.radians(-60.0), math.radians(120.0)
