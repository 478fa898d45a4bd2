# SPDX-License-Identifier: GPL-3.0-or-later
"""What the passes of data read of a scene, as arrays: ids of mattes, motion, columns of AOVs."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from engine.array_types import Float32Array
from engine.builder.camera_spaces import camera_matrices
from engine.builder.scene import Scene
from engine.scene.cryptomatte import matte_ids
from engine.scene.description import Camera, Frame, SceneDescription
from engine.scene.passes import PassMotion
from engine.state.data_passes import DataOptions, DataView, no_data
from engine.state.shaders import CAMERA_WORLD_TO_CAMERA, CAMERA_WORLD_TO_NDC

#: What Cycles calls the material of faces that have none.
_DEFAULT_MATERIAL = "default_surface"


def build_data_view(scene: Scene, options: DataOptions) -> DataView:
    """Arrays for the passes that `options` ask for; empty ones for all others."""
    description = scene.description
    view = no_data()._replace(options=options)
    if options.object_mattes >= 0 or options.asset_mattes >= 0:
        instances = description.instances
        assets = instances.name if instances.asset is None else instances.asset
        ids = np.stack([matte_ids(instances.name), matte_ids(assets)], axis=1)
        view = view._replace(instance_ids=np.ascontiguousarray(ids, np.float32))
    if options.material_mattes >= 0:
        names = [material.name for material in description.materials]
        view = view._replace(program_ids=matte_ids([*names, _DEFAULT_MATERIAL]))
    if options.knows_motion:
        view = view._replace(**_motion_arrays(description))
    return view


def _motion_arrays(description: SceneDescription) -> dict[str, np.ndarray]:
    """Fields of `DataView` by which motion vectors, and motion for denoisers, are made."""
    motion, instances = description.passes.motion or PassMotion(), description.instances
    shape_rows = np.full(max(len(description.meshes), 1), -1, np.int32)
    vertices: list[Float32Array] = []
    for mesh, shape in sorted(motion.shapes.items()):
        shape_rows[mesh] = sum(map(len, vertices))
        vertices.append(shape.reshape(-1, 3))
    changes_shape = shape_rows[instances.mesh] >= 0
    rows = np.full(max(len(instances.mesh), 1), -1, np.int32)
    matrices: list[np.ndarray] = []
    for index in sorted({*motion.instances, *np.flatnonzero(changes_shape).tolist()}):
        now = instances.transform[index].astype(np.float64)
        then = np.asarray(motion.instances.get(index, np.stack([now, now])), np.float64)
        if not changes_shape[index]:
            if not np.isfinite(now).all() or np.linalg.det(now[:3, :3]) == 0.0:
                continue
            then = then @ np.linalg.inv(now)
        rows[index] = len(matrices)
        matrices.append(then[:, :3].reshape(2, 12))
    camera = description.camera
    cameras = [camera] * 3
    if motion.camera is not None:
        cameras[1:] = [replace(camera, transform=transform) for transform in motion.camera]
    if motion.lens is not None:
        for step, (lens, width, height) in enumerate(motion.lens.tolist(), 1):
            cameras[step] = replace(cameras[step], lens=lens, sensor_width=width, sensor_height=height)
    rasters = [_world_to_raster(camera, description.frame) for camera in cameras]
    return {
        "motion_rows": rows,
        "motion_matrices": np.array(matrices, np.float32).reshape(-1, 12),
        "shape_rows": shape_rows,
        "shape_vertices": np.concatenate([np.zeros((0, 3), np.float32), *vertices]).astype(np.float32),
        "rasters": np.array(rasters, np.float32).reshape(3, 12),
        "depths": np.array([_world_to_depth(camera, description.frame) for camera in cameras[:2]], np.float32),
    }


def _world_to_raster(camera: Camera, frame: Frame) -> np.ndarray:
    """A row of `DataView.rasters`."""
    if camera.kind not in ("PERSP", "ORTHO"):
        return np.linalg.inv(np.asarray(camera.transform, np.float64))[:3].ravel()
    window = camera_matrices(camera, frame)[CAMERA_WORLD_TO_NDC, :12].astype(np.float64)
    return (window.reshape(3, 4) * np.array([[frame.width], [frame.height], [1.0]])).ravel()


def _world_to_depth(camera: Camera, frame: Frame) -> np.ndarray:
    """A row of `DataView.depths`; of panoramas along the camera's upward axis, as in Cycles, whose z that is."""
    axis = 2 if camera.kind in ("PERSP", "ORTHO") else 1
    return camera_matrices(camera, frame)[CAMERA_WORLD_TO_CAMERA, 4 * axis : 4 * axis + 4]
