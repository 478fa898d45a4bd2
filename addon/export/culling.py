# SPDX-License-Identifier: GPL-3.0-or-later
"""Objects that Simplify leaves out: those that the camera does not see, and those that are far from it."""

from __future__ import annotations

import bpy
import numpy as np
import numpy.typing as npt

from engine.scene.description import Frame

from .context import ExportContext, cycles_property
from .dicing_view import DicingView
from .instances import Appearance, Appearances


def view_of_render(context: ExportContext, camera_object: bpy.types.Object, frame: Frame) -> DicingView:
    """What a picture shows of the scene; `camera_object` is original."""
    camera = camera_object.evaluated_get(context.depsgraph)
    return DicingView.of_camera(context.depsgraph, camera, frame.width, frame.height)


def culls(scene: bpy.types.Scene) -> bool:
    """Whether Simplify leaves out anything."""
    switches = ("use_camera_cull", "use_distance_cull")
    return bool(scene.render.use_simplify and any(cycles_property(scene, name, False) for name in switches))


def cull(context: ExportContext, view: DicingView, appearances: Appearances) -> None:
    """Leave out what the scene, which `culls`, and its objects want culled, by the boxes around them, as Cycles does.

    Parameters
    ----------
    appearances : Appearances
        Changed: what is culled is shown as nothing.
    """
    scene = context.scene
    if scene.render.use_multiview or view.kind == "PANO":
        return
    margin = cycles_property(scene, "camera_cull_margin", 0.1)
    reach = cycles_property(scene, "distance_cull_margin", 50.0)
    by_view = cycles_property(scene, "use_camera_cull", False)
    by_distance = cycles_property(scene, "use_distance_cull", False) and reach > 0.0
    position = np.linalg.inv(view.to_camera)[:3, 3]
    for row, kind in enumerate(appearances.kinds):
        of_view = by_view and _wants(kind, "use_camera_cull")
        of_distance = by_distance and _wants(kind, "use_distance_cull")
        if kind.light is not None or not (of_view or of_distance):
            continue
        mine = np.flatnonzero(appearances.kind == row)
        box = np.array(kind.owner.bound_box, np.float64)
        transform = appearances.transform[mine].astype(np.float64)
        corners = box @ transform[:, :3, :3].transpose(0, 2, 1) + transform[:, None, :3, 3]
        is_culled = np.ones(len(mine), np.bool_)
        if of_view:
            is_culled &= _is_out_of_view(view, corners, margin)
        if of_distance:
            is_culled &= _is_far(position, corners, reach)
        appearances.kind[mine[is_culled]] = -1


def _wants(kind: Appearance, name: str) -> bool:
    return bool(cycles_property(kind.owner, name, False))


def _is_far(
    position: npt.NDArray[np.float64], corners: npt.NDArray[np.float64], reach: float
) -> npt.NDArray[np.bool_]:
    """Which boxes, corners float64 (N, 8, 3), have upright boxes around them that lie beyond a distance [m]."""
    nearest = np.clip(position, corners.min(axis=1), corners.max(axis=1))
    is_far: npt.NDArray[np.bool_] = ((position - nearest) ** 2).sum(axis=1) > reach * reach
    return is_far


def _is_out_of_view(view: DicingView, corners: npt.NDArray[np.float64], margin: float) -> npt.NDArray[np.bool_]:
    """Which boxes, corners float64 (N, 8, 3), have none of their corners' surroundings in the picture.

    Corners behind the camera are mirrored in the picture's middle, and a box with all of them there is out of view.

    Parameters
    ----------
    margin : float
        By which the picture is larger on each side, in pictures.
    """
    near = view.nearest
    far = max(view.farthest, near + 1e-3 * abs(near))
    seen = corners @ view.to_camera[:3, :3].T + view.to_camera[:3, 3]
    clip = seen @ view.projection[:, :3].T + view.projection[:, 3]
    with np.errstate(divide="ignore", invalid="ignore"):
        place = 0.5 * clip[..., :2] / clip[..., 3:] + 0.5
    depth = (-seen[..., 2] - near) / (far - near)
    if view.kind == "PERSP":
        depth *= far
    is_behind = depth < 0.0
    place = np.where(is_behind[..., None], 1.0 - place, place)
    low, high = place.min(axis=1), place.max(axis=1)
    is_beside = (low >= 1.0 + margin).any(axis=1) | (high <= -margin).any(axis=1)
    result: npt.NDArray[np.bool_] = (depth < -margin).all(axis=1) | is_beside
    return result
