# SPDX-License-Identifier: GPL-3.0-or-later
"""Wax that lies in fog, or moves: light goes in below its surface where other things happen too."""

from __future__ import annotations

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, box, lit_stage, material, sphere


def _wax(nodes: Nodes) -> Socket:
    return nodes(
        "SubsurfaceScattering", {"falloff": "RANDOM_WALK"}, Color=(0.95, 0.92, 0.85), Radius=(1.0, 0.8, 0.6), Scale=0.5
    )


@scene("subsurface-in-fog", samples=256)
def in_fog() -> None:
    """A ball of wax, half of it in a box of dark red fog, into and out of which light goes below the ball's surface."""
    lit_stage()
    add_object("Ball", sphere("Ball", material("Wax", _wax), 0.7), (0.0, 0.0, 0.9))
    fog = material("Fog", None, lambda nodes: nodes("VolumeAbsorption", Color=(0.7, 0.1, 0.05), Density=2.0))
    add_object("Fog", box("Box", fog, (1.7, 1.9, 1.8)), (0.85, 0.0, 0.91))


@scene("subsurface-moving", samples=128)
def moving() -> None:
    """Wax that is squeezed, beside a box of it that turns and stretches, while the shutter is open."""
    lit_stage()
    surface = material("Wax", _wax)
    ball = add_object("Ball", sphere("Ball", surface, 0.5), (-0.7, 0.0, 0.7))
    ball.shape_key_add(name="Basis")
    squeezed = ball.shape_key_add(name="Squeezed")
    for point in squeezed.data:
        point.co.z *= 0.4
        point.co.x *= 1.5
    turned = add_object("Turned", box("Box", surface, (0.7, 0.7, 0.7)), (0.8, 0.0, 0.7))
    for frame, value, angle in ((0, 0.0, 0.0), (2, 1.0, 1.2)):
        squeezed.value = value
        squeezed.keyframe_insert("value", frame=frame)
        turned.rotation_euler = (0.0, angle, angle)
        turned.keyframe_insert("rotation_euler", frame=frame)
        turned.scale = (1.0, 1.0, 1.0 + 0.3 * value)
        turned.keyframe_insert("scale", frame=frame)
    render = bpy.context.scene.render
    render.use_motion_blur, render.motion_blur_shutter = True, 1.0
    bpy.context.scene.frame_set(1)
