# SPDX-License-Identifier: GPL-3.0-or-later
"""Motion vectors: how far what is seen moves over the image from the frame before, and to the frame after."""

import numpy as np

from engine.kernels.panorama import panorama_position
from engine.kernels.vector import dot, load, normalize, scale, subtract, transform_direction, transform_point
from engine.runtime.jit import kernel
from engine.state.camera import (
    CAMERA_KIND,
    CAMERA_OFFSET_X,
    CAMERA_OFFSET_Y,
    CAMERA_SCALE_X,
    CAMERA_SCALE_Y,
    KIND_PANORAMA,
)
from engine.state.data_passes import RASTER_AFTER, RASTER_BEFORE, RASTER_NOW
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
    INSTANCE_FLAGS,
    INSTANCE_MESH,
    MESH_FIRST_VERTEX,
    MESH_SHAPE,
    MESH_VERTEX_COUNT,
    SHAPE_TRIANGLES,
)


@kernel
def _on_panorama(camera, d):
    """Where a panoramic camera sees a direction from it [pixels]."""
    x, y = panorama_position(camera, normalize(d))
    x = (x - camera[CAMERA_OFFSET_X]) / camera[CAMERA_SCALE_X]
    return x, (y - camera[CAMERA_OFFSET_Y]) / camera[CAMERA_SCALE_Y]


@kernel
def _on_image(data, camera, raster, p):
    """Where the camera of row `raster` sees a point of the world [pixels]."""
    projected = transform_point(data.rasters, raster, p)
    if int(camera[CAMERA_KIND]) == KIND_PANORAMA:
        return _on_panorama(camera, projected)
    if projected[2] == 0.0:
        return 0.0 * projected[0], 0.0 * projected[1]
    return projected[0] / projected[2], projected[1] / projected[2]


@kernel
def _direction_on_image(data, camera, raster, d):
    """Where the camera of row `raster` sees a direction of the world, as Cycles has it [pixels].

    It leaves out the division by depth, so that what is far from the image's middle moves a little less.
    """
    projected = transform_direction(data.rasters, raster, d)
    if int(camera[CAMERA_KIND]) == KIND_PANORAMA:
        return _on_panorama(camera, projected)
    return projected[0], projected[1]


@kernel
def _shape_point(data, geometry, mesh, triangle, u, v, after):
    """A point of a triangle of a mesh that changes its shape, in object space, before (0) or after (1)."""
    shift = np.int64(data.shape_rows[mesh]) - geometry.mesh_table[mesh, MESH_FIRST_VERTEX]
    shift += after * np.int64(geometry.mesh_table[mesh, MESH_VERTEX_COUNT])
    a = load(data.shape_vertices, np.int64(geometry.triangles[triangle, 0]) + shift)
    b = load(data.shape_vertices, np.int64(geometry.triangles[triangle, 1]) + shift)
    c = load(data.shape_vertices, np.int64(geometry.triangles[triangle, 2]) + shift)
    w = 1.0 - u - v
    return (
        w * a[0] + u * b[0] + v * c[0],
        w * a[1] + u * b[1] + v * c[1],
        w * a[2] + u * b[2] + v * c[2],
    )


@kernel
def _seen_at(geometry, instance, row, u, p):
    """Where Cycles sees a point of a surface: of curves and spheres in their middle, straight between keys."""
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if geometry.mesh_table[mesh, MESH_SHAPE] == SHAPE_TRIANGLES:
        return p
    a = load(geometry.vertices, np.int64(geometry.triangles[row, 0]))
    b = load(geometry.vertices, np.int64(geometry.triangles[row, 1]))
    w = 1.0 - u
    p = (w * a[0] + u * b[0], w * a[1] + u * b[1], w * a[2] + u * b[2])
    if geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        return p
    return transform_point(geometry.transforms, instance, p)


@kernel
def _elsewhen(data, geometry, instance, triangle, u, v, p, after):
    """Where a point of a surface is before (0) or after (1), in the world."""
    row = data.motion_rows[instance]
    if row < 0:
        return p
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if data.shape_rows[mesh] >= 0:
        p = _shape_point(data, geometry, mesh, triangle, u, v, after)
    return transform_point(data.motion_matrices, 2 * row + after, p)


@kernel
def motion_vectors(data, camera, geometry, instance, triangle, u, v, p):
    """Motion of what is seen at `p` [pixels], as Cycles' pass has it.

    Returns
    -------
    x, y from where it is to where it was in the frame before; x, y from where it will be to where it is
    """
    p = _seen_at(geometry, instance, triangle, u, p)
    before = _elsewhen(data, geometry, instance, triangle, u, v, p, 0)
    after = _elsewhen(data, geometry, instance, triangle, u, v, p, 1)
    now_x, now_y = _on_image(data, camera, RASTER_NOW, p)
    before_x, before_y = _on_image(data, camera, RASTER_BEFORE, before)
    after_x, after_y = _on_image(data, camera, RASTER_AFTER, after)
    return before_x - now_x, before_y - now_y, now_x - after_x, now_y - after_y


@kernel
def background_vectors(data, camera, d):
    """Motion of the background in a direction [pixels]; returns as `motion_vectors`."""
    now_x, now_y = _direction_on_image(data, camera, RASTER_NOW, d)
    before_x, before_y = _direction_on_image(data, camera, RASTER_BEFORE, d)
    after_x, after_y = _direction_on_image(data, camera, RASTER_AFTER, d)
    return before_x - now_x, before_y - now_y, now_x - after_x, now_y - after_y


@kernel
def _depth(data, row, p):
    """How far a point of the world is along the axis of the camera of row `row` [m]."""
    depths = data.depths
    return depths[row, 0] * p[0] + depths[row, 1] * p[1] + depths[row, 2] * p[2] + depths[row, 3]


@kernel
def backward_motion(data, camera, geometry, instance, triangle, u, v, p):
    """Where what is seen at `p` was in the frame before, as temporal denoisers ask for it.

    Returns
    -------
    x, y from where it is to where it was [pixels]; how much deeper it was [m]
    """
    p = _seen_at(geometry, instance, triangle, u, p)
    before = _elsewhen(data, geometry, instance, triangle, u, v, p, 0)
    now_x, now_y = _on_image(data, camera, RASTER_NOW, p)
    before_x, before_y = _on_image(data, camera, RASTER_BEFORE, before)
    depth = _depth(data, RASTER_BEFORE, before) - _depth(data, RASTER_NOW, p)
    return before_x - now_x, before_y - now_y, depth


@kernel
def _behind_mirror(mirror, normal, p):
    """Where a flat mirror at a point of it, with this unit normal, shows `p`."""
    return subtract(p, scale(normal, 2.0 * dot(normal, subtract(p, mirror))))


@kernel
def reflected_motion(data, camera, geometry, instance, triangle, u, v, p, mirror, normal):
    """Where the mirror image of what is at `p` was in the frame before, as Cycles has it: the mirror is flat and stands
    still.

    Parameters
    ----------
    mirror, normal : tuple of 3 float32, world [m] and unit
        Where the camera's ray was reflected.

    Returns
    -------
    x, y from where it is to where it was [pixels]
    """
    p = _seen_at(geometry, instance, triangle, u, p)
    before = _elsewhen(data, geometry, instance, triangle, u, v, p, 0)
    now_x, now_y = _on_image(data, camera, RASTER_NOW, _behind_mirror(mirror, normal, p))
    before_x, before_y = _on_image(data, camera, RASTER_BEFORE, _behind_mirror(mirror, normal, before))
    return before_x - now_x, before_y - now_y
