# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: passes of data and Cryptomattes of what the camera sees. Run only if such a pass was asked for.

What is summed and what is of one surface is as in Cycles: mist and mattes are of every surface through which the camera
sees another, by what is let through; the rest is of the first that is opaque enough.
"""

import math

import numpy as np

from engine.kernels.bsdf.pass_roughness import pass_roughness
from engine.kernels.mattes import add_matte
from engine.kernels.pass_surface import is_pass_surface, mean_transparency
from engine.kernels.pass_vectors import background_vectors, backward_motion, motion_vectors
from engine.kernels.shader.surface import fetch_attribute
from engine.kernels.vector import load
from engine.runtime.jit import kernel
from engine.state.camera import CAMERA_KIND, KIND_ORTHOGRAPHIC
from engine.state.data_passes import ID_ASSET, ID_OBJECT
from engine.state.geometry import INSTANCE_MESH, MESH_DEFAULT_UV
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_P,
    POINT_PROGRAM,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    RAY_PASSES_DONE,
    RAY_TRANSPARENT_BACKGROUND,
)


@kernel
def _clearness(options, camera, p):
    """One less mist, from 1 before it begins to 0 behind it."""
    x, y, z = p[0] - camera[3], p[1] - camera[7], p[2] - camera[11]
    if int(camera[CAMERA_KIND]) == KIND_ORTHOGRAPHIC:
        distance = abs(camera[2] * x + camera[6] * y + camera[10] * z)
    else:
        distance = np.sqrt(x * x + y * y + z * z)
    mist = min(max((distance - options.mist_start) * options.mist_inverse_depth, 0.0), 1.0)
    return 1.0 - mist**options.mist_falloff


@kernel
def _write_mattes(data, mattes, pixel, instance, program, weight):
    """Add a surface's weight to what covers the pixel."""
    options = data.options
    slots = options.matte_slots
    if options.object_mattes >= 0:
        add_matte(mattes, pixel, options.object_mattes, slots, data.instance_ids[instance, ID_OBJECT], weight)
    if options.material_mattes >= 0:
        add_matte(mattes, pixel, options.material_mattes, slots, data.program_ids[program], weight)
    if options.asset_mattes >= 0:
        add_matte(mattes, pixel, options.asset_mattes, slots, data.instance_ids[instance, ID_ASSET], weight)


@kernel
def write_data(scene, unit, work, queue):
    """Add mist, UV, roughness, motion vectors and mattes of shaded lanes that have not scattered yet to the film."""
    data, camera, geometry = scene.data, scene.camera, scene.geometry
    options, paths, points, closures, film = data.options, work.paths, work.points, work.shaded, unit.film
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if paths.alive[lane] == 0 or not flags & RAY_TRANSPARENT_BACKGROUND:
            continue
        pixel = paths.pixel[lane]
        instance = points.integer[lane, POINT_INSTANCE]
        p = (points.real[lane, POINT_P], points.real[lane, POINT_P + 1], points.real[lane, POINT_P + 2])
        through = 0.0
        for c in range(len(paths.channels)):
            through += paths.throughput[lane, c]
        covered = (1.0 - mean_transparency(closures, lane)) * through / np.float32(len(paths.channels))
        if covered > 0.0:
            if options.mist >= 0:
                film.data[pixel, options.mist] += covered * _clearness(options, camera, p)
            if options.matte_slots > 0:
                _write_mattes(data, film.mattes, pixel, instance, points.integer[lane, POINT_PROGRAM], covered)
        if flags & RAY_PASSES_DONE or not is_pass_surface(closures, lane, options.alpha_threshold):
            continue
        triangle = points.integer[lane, POINT_TRIANGLE]
        u, v = points.real[lane, POINT_U], points.real[lane, POINT_V]
        if options.uv >= 0:
            slot = geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_DEFAULT_UV]
            map_u, map_v, _z, _w, components = fetch_attribute(geometry, instance, triangle, slot, u, v)
            if components > 0:
                film.data[pixel, options.uv] += map_u
                film.data[pixel, options.uv + 1] += map_v
                film.data[pixel, options.uv + 2] += 1.0
        if options.surface_roughness >= 0:
            film.data[pixel, options.surface_roughness] += pass_roughness(closures, lane)
        if options.vector >= 0:
            vectors = motion_vectors(data, camera, geometry, instance, triangle, u, v, p)
            for c in range(4):
                film.data[pixel, options.vector + c] += vectors[c]
            film.data[pixel, options.vector + 4] += 1.0
        if options.backward_motion >= 0:
            motion = backward_motion(data, camera, geometry, instance, triangle, u, v, p)
            if math.isfinite(motion[0] + motion[1] + motion[2]):
                for c in range(3):
                    film.data[pixel, options.backward_motion + c] += motion[c]


@kernel
def write_background_vectors(scene, unit, work, queue):
    """Add motion of the background to the film, of lanes that no surface has stopped: vectors where Blender's version
    has some, and backward motion.

    Parameters
    ----------
    queue : LaneQueue
        `work.missed`.
    """
    data, camera = scene.data, scene.camera
    options, paths, film = data.options, work.paths, unit.film
    has_vectors = options.background_moves != 0 and options.vector >= 0
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if flags & RAY_PASSES_DONE or not flags & RAY_TRANSPARENT_BACKGROUND:
            continue
        vectors = background_vectors(data, camera, load(paths.direction, lane))
        pixel = paths.pixel[lane]
        if has_vectors:
            for c in range(4):
                film.data[pixel, options.vector + c] += vectors[c]
            film.data[pixel, options.vector + 4] += 1.0
        if options.backward_motion >= 0:
            film.data[pixel, options.backward_motion] += vectors[0]
            film.data[pixel, options.backward_motion + 1] += vectors[1]


@kernel
def write_aovs(scene, unit, work, queue):
    """Add what programs have left for AOVs to the film, and leave their rows empty for the next programs."""
    options, paths, closures, film = scene.data.options, work.paths, work.shaded, unit.film
    lanes, lane_count = queue.lanes, queue.count[0]
    width = options.aov_width
    for k in range(lane_count):
        lane = lanes[k]
        for column in range(width):
            value = closures.aovs[lane * width + column]
            if value != 0.0:
                if math.isfinite(value):
                    film.data[paths.pixel[lane], options.aov + column] += value
                closures.aovs[lane * width + column] = 0.0
