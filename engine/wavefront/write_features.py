# SPDX-License-Identifier: GPL-3.0-or-later
"""Stage: passes of the first surface that is opaque enough. Runs only if such a pass was asked for."""

import numpy as np

from engine.kernels.bsdf import albedo
from engine.kernels.pass_surface import is_pass_surface
from engine.runtime.jit import kernel
from engine.state.camera import CAMERA_KIND, KIND_PANORAMA
from engine.state.film import (
    FEATURE_ALBEDO,
    FEATURE_NORMAL,
    FIRST_DEPTH,
    FIRST_MATERIAL_INDEX,
    FIRST_OBJECT_INDEX,
    FIRST_POSITION,
)
from engine.state.geometry import INSTANCE_PASS_INDEX
from engine.state.lanes import (
    POINT_INSTANCE,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_WO,
    RAY_PASSES_DONE,
    RAY_TRANSPARENT_BACKGROUND,
)


@kernel
def write_features(scene, unit, work, queue):
    """Write depth, position and indices (first sample only) and add normal and albedo to the film.

    Surfaces that are not opaque enough leave both to what is behind them; with nothing there the first sample shows
    nothing (`shade_background`), unless it was scattered.
    """
    camera, geometry, tables, pass_index = scene.camera, scene.geometry, scene.tables, scene.shaders.program_pass_index
    paths, points, closures, scratch, film = work.paths, work.points, work.shaded, work.f_cos, unit.film
    threshold, looks_up = scene.data.options.alpha_threshold, scene.data.options.looks_up_transmission
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        flags = paths.flags[lane]
        if flags & RAY_PASSES_DONE or not flags & RAY_TRANSPARENT_BACKGROUND or paths.alive[lane] == 0:
            continue
        pixel = paths.pixel[lane]
        real = points.real
        instance = points.integer[lane, POINT_INSTANCE]
        if paths.sample[lane] == 0:
            x = real[lane, POINT_P] - camera[3]
            y = real[lane, POINT_P + 1] - camera[7]
            z = real[lane, POINT_P + 2] - camera[11]
            if int(camera[CAMERA_KIND]) == KIND_PANORAMA:
                depth = np.sqrt(x * x + y * y + z * z)
            else:
                depth = -(camera[2] * x + camera[6] * y + camera[10] * z)
            film.points[pixel, FIRST_DEPTH] = depth
            for c in range(3):
                film.points[pixel, FIRST_POSITION + c] = real[lane, POINT_P + c]
            film.points[pixel, FIRST_OBJECT_INDEX] = np.float32(geometry.instance_table[instance, INSTANCE_PASS_INDEX])
            film.points[pixel, FIRST_MATERIAL_INDEX] = pass_index[points.integer[lane, POINT_PROGRAM]]
        if not is_pass_surface(closures, lane, threshold):
            continue
        paths.flags[lane] = flags | RAY_PASSES_DONE
        wo = (real[lane, POINT_WO], real[lane, POINT_WO + 1], real[lane, POINT_WO + 2])
        albedo(closures, tables, lane, wo, looks_up, scratch, lane)
        for c in range(3):
            film.features[pixel, FEATURE_NORMAL + c] += real[lane, POINT_NS + c]
            film.features[pixel, FEATURE_ALBEDO + c] += scratch[lane, c]
