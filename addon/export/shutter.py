# SPDX-License-Identifier: GPL-3.0-or-later
"""When the shutter is open, who is blurred meanwhile, and how Blender is moved through these times."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array

from ..versions import read_setting
from .context import ExportContext, cycles_property
from .subdivision import apply_levels

#: Cycles' most times of an object: 2**7 + 1.
_MAX_STEPS = 7
#: Times that motion vectors know: the frame before, the frame, and the frame after.
VECTOR_STEPS = 3
#: Entries of the shutter's curve.
_CURVE_SIZE = 256
#: Blender's own limits of frame numbers.
_MIN_FRAME, _MAX_FRAME = -1048574, 1048574


@dataclass(frozen=True)
class Shutter:
    """When the shutter is open [frames]: the frame that is rendered, the middle, and how long.

    `centre` is beside `frame` unless the position is CENTER.
    """

    frame: float
    centre: float
    length: float

    def time(self, relative: float) -> float:
        """Time [frames] at `relative` in [-1, 1], from opening to closing."""
        return self.centre + 0.5 * relative * self.length


def has_motion_blur(context: ExportContext) -> bool:
    """Whether scene and view layer want motion blur, and the shutter is open for any time.

    Raises
    ------
    ValueError
        If they do, and nobody knows for how long.
    """
    render = context.scene.render
    is_wanted = render.use_motion_blur and getattr(context.view_layer, "use_motion_blur", True)
    shutter = render.motion_blur_shutter
    if is_wanted and not math.isfinite(shutter):
        raise ValueError(f"the shutter is open for {shutter} frames: check its keyframes and drivers")
    return bool(is_wanted) and shutter > 0.0


def read_shutter(context: ExportContext) -> Shutter | None:
    """The scene's shutter at the frame Blender stands at, None without motion blur."""
    if not has_motion_blur(context):
        return None
    scene = context.scene
    frame = scene.frame_current + scene.frame_subframe
    length = scene.render.motion_blur_shutter
    position = read_setting(scene.render, "motion_blur_position", scene)
    offset = {"START": 0.5 * length, "END": -0.5 * length}.get(position, 0.0)
    return Shutter(frame, frame + offset, length)


def read_shutter_curve(render: bpy.types.RenderSettings) -> Float32Array | None:
    """How far the shutter is open from its opening to its closing, float32 (256,); None where it is always 1."""
    mapping = getattr(render, "motion_blur_shutter_curve", None)
    if mapping is None:
        return None
    mapping.initialize()
    curve = mapping.curves[0]
    values = [mapping.evaluate(curve, i / (_CURVE_SIZE - 1)) for i in range(_CURVE_SIZE)]
    opened = np.maximum(np.array(values, np.float32), 0.0)
    return None if np.abs(opened - 1.0).max() <= 1e-3 else opened


def read_rolling_shutter(scene: bpy.types.Scene) -> float:
    """Share of the shutter's time in which a row of the image is exposed, 1 without a rolling one: Cycles' settings."""
    if cycles_property(scene, "rolling_shutter_type", "NONE") == "NONE":
        return 1.0
    duration = float(cycles_property(scene, "rolling_shutter_duration", 0.1))
    if not math.isfinite(duration):
        raise ValueError(f"the rolling shutter's duration is {duration}: check its keyframes and drivers")
    return duration


def motion_step_count(shown: bpy.types.Object, parent: bpy.types.Object | None = None) -> int:
    """Evenly spaced times at which an object is looked at, 0 if it is not blurred.

    Parameters
    ----------
    parent : Object, optional
        Its instancer, which has a say too.
    """
    owners = [shown] if parent is None or parent == shown else [shown, parent]
    if not all(cycles_property(owner, "use_motion_blur", True) for owner in owners):
        return 0
    steps = max(cycles_property(owner, "motion_steps", 1) for owner in owners)
    return 2 ** min(max(steps, 1), _MAX_STEPS) + 1


def uses_deform_motion(shown: bpy.types.Object, parent: bpy.types.Object) -> bool:
    """Whether an object and its instancer let its shape be blurred."""
    return all(cycles_property(owner, "use_deform_motion", True) for owner in (shown, parent))


class Clock:
    """Moves Blender to other times and back to the frame it was found at."""

    def __init__(self, context: ExportContext) -> None:
        self._context = context
        scene = context.depsgraph.scene
        self._found = scene.frame_current + scene.frame_subframe
        self._is_elsewhere = False

    def go_to(self, time: float) -> None:
        """Evaluate everything at `time` [frames]; nothing evaluated before may be used any more."""
        frame, subframe = split_time(time)
        context = self._context
        self._is_elsewhere = True
        engine: Any = context.engine
        if engine is not None:
            engine.frame_set(frame, subframe)
        else:
            context.depsgraph.scene.frame_set(frame, subframe=subframe)
        # An animated scene is copied anew, and its view layers with it.
        context.scene = context.depsgraph.scene_eval
        context.view_layer = context.depsgraph.view_layer_eval
        apply_levels(context)

    def restore(self) -> None:
        """Go back to the frame found, if this clock ever left it."""
        if self._is_elsewhere:
            self.go_to(self._found)
            self._is_elsewhere = False


def split_time(time: float) -> tuple[int, float]:
    """Whole frame and the rest in [0, 1), which Blender keeps as a float32."""
    time = min(max(time, float(_MIN_FRAME)), float(_MAX_FRAME))
    frame = math.floor(time)
    subframe = float(np.float32(time - frame))
    return (frame, subframe) if subframe < 1.0 else (frame + 1, 0.0)
