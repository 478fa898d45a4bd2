# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion vectors: what moves from the frame before to the frame after, found as motion blur finds it."""

from __future__ import annotations

from dataclasses import replace

import bpy
import numpy as np
import numpy.typing as npt

from engine.scene.description import SceneDescription
from engine.scene.passes import PassMotion

from .context import ExportContext
from .instances import Appearances
from .motion import add_motion
from .shutter import Clock, Shutter

#: The first and the last of all times.
_ENDS = [0, -1]


def find_pass_motion(
    context: ExportContext, description: SceneDescription, appearances: Appearances, chosen: npt.NDArray[np.intp],
    camera_object: bpy.types.Object,
) -> PassMotion:
    """Visit the frames beside the one that Blender stands at, and come back.

    Parameters
    ----------
    description : SceneDescription
        Stays as it is.
    appearances, chosen, camera_object
        As in `motion.add_motion`.

    Raises
    ------
    ExportCancelled
        Once `should_cancel()` is true.
    """
    # What is said of motion blur is not said of vectors.
    quiet = replace(context, _notices={})
    seen = replace(
        description, camera=replace(description.camera), instances=replace(description.instances),
        meshes=list(description.meshes),
    )
    frame = context.scene.frame_current + context.scene.frame_subframe
    clock = Clock(quiet)
    try:
        add_motion(quiet, clock, Shutter(frame, frame, 2.0), seen, appearances, chosen, camera_object)
    finally:
        clock.restore()
        context.scene, context.view_layer = quiet.scene, quiet.view_layer
    camera = seen.camera.motion
    return PassMotion(
        camera=None if camera is None else camera[_ENDS],
        lens=seen.camera.lens_motion,
        instances={index: motion[_ENDS] for index, motion in seen.instances.motion.items()},
        shapes={
            index: mesh.motion_vertices[_ENDS]
            for index, mesh in enumerate(seen.meshes)
            if mesh.motion_vertices is not None
        },
    )
