# SPDX-License-Identifier: GPL-3.0-or-later
"""A window's camera, as Blender draws the window."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from engine.scene.description import Camera
from engine.viewport.view import Region, View

from ..export.camera import export_camera, film_exposure
from ..export.context import ExportContext
from ..export.dicing_view import DicingView
from .window import border_region, frame_in_window, panorama_plane, plane_of, within

if TYPE_CHECKING:
    import bpy


def read_view(
    context: ExportContext, region: bpy.types.Region, space: bpy.types.SpaceView3D, region_3d: bpy.types.RegionView3D
) -> View:
    """What a window shows: its camera, its size, and the part of it that a border leaves.

    Raises
    ------
    ValueError
        Naming what is wrong with the camera that is looked through.
    """
    scene = context.scene
    width, height = max(region.width, 1), max(region.height, 1)
    is_perspective = bool(region_3d.is_perspective)
    plane = plane_of(np.array(region_3d.window_matrix, np.float32), is_perspective=is_perspective)
    camera_object = None
    if region_3d.view_perspective == "CAMERA":
        camera_object = space.camera if space.use_local_camera else scene.camera
    border = None
    if camera_object is None:
        camera = _free_camera(space, is_perspective=is_perspective)
        if space.use_render_border:
            border = (
                space.render_border_min_x, space.render_border_min_y, space.render_border_max_x,
                space.render_border_max_y,
            )  # fmt: skip
    else:
        camera = export_camera(context, camera_object)
        frame = (0.0, 0.0, 1.0, 1.0)
        if camera_object.type == "CAMERA":
            corners = np.array(camera_object.data.view_frame(scene=scene.original), np.float32)
            frame = frame_in_window(corners, plane, is_perspective=is_perspective)
        if camera.kind == "PANO":
            plane = panorama_plane(frame, camera.panorama.window)
        render = scene.render
        if render.use_border:
            border = within(frame, (render.border_min_x, render.border_min_y, render.border_max_x, render.border_max_y))
    transform = np.linalg.inv(np.array(region_3d.view_matrix, np.float64)).astype(np.float32)
    pixels: Region = (0, 0, width, height) if border is None else border_region(width, height, border)
    return View(replace(camera, transform=transform), plane, width, height, pixels, film_exposure(scene))


def dicing_view(
    region: bpy.types.Region, space: bpy.types.SpaceView3D, region_3d: bpy.types.RegionView3D
) -> DicingView:
    """By what a window dices meshes: its own view."""
    kind = "PERSP" if region_3d.is_perspective else "ORTHO"
    return DicingView(
        np.array(region_3d.view_matrix, np.float64), np.array(region_3d.window_matrix, np.float64), kind,
        max(region.width, 1), max(region.height, 1), space.clip_start, space.clip_end,
    )  # fmt: skip


def culling_view(view: View, dicing: DicingView) -> DicingView:
    """By what a window leaves out objects: what it shows, as far as its camera sees."""
    camera = view.camera
    return replace(dicing, kind=camera.kind, nearest=camera.clip_start, farthest=camera.clip_end)


def _free_camera(space: bpy.types.SpaceView3D, *, is_perspective: bool) -> Camera:
    """The camera of a window that looks through none of the scene's."""
    if is_perspective:
        return Camera(lens=space.lens, clip_start=space.clip_start, clip_end=space.clip_end)
    # As Cycles: what lies behind such a window is seen too.
    far = 0.5 * space.clip_end
    return Camera(kind="ORTHO", clip_start=-far, clip_end=far)
