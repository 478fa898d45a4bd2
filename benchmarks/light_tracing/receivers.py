# SPDX-License-Identifier: GPL-3.0-or-later
"""What a camera can be connected to: surfaces whose light it receives from everywhere, not from single directions."""

from __future__ import annotations

import numpy as np

from benchmarks.light_tracing.emitters import AREA, KIND, MIDDLE, POINT
from engine.accel.rays import read_hit, trace_closest
from engine.kernels.bsdf import HAS_DELTA, HAS_TRANSMISSION, HAS_TRANSPARENT, rough_share, summarize
from engine.kernels.camera import generate_ray, sample_table
from engine.kernels.shader.interpreter import evaluate_shaders
from engine.kernels.surface import prepare_point, program_of
from engine.kernels.vector import dot, subtract
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_CAMERA
from engine.state.lanes import (
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    RAY_CAMERA,
)
from engine.state.shaders import MODE_CLOSURES, PROGRAM_FLAGS, PROGRAM_HAS_EMISSION

#: Lobes that are all narrower than this [alpha] show single directions, as mirrors do.
LEAST_ALPHA = np.float32(0.05)
#: Rays a side of a pixel's footprint by which it is found out what is seen there.
_LOOKS = 6


@kernel
def shade(scene, lanes, hit, direction, kind):
    """Run the program of what a ray along `direction` has hit; returns the bound on the point's rounding error [m].

    Parameters
    ----------
    scene : TracedScene
    lanes : PhotonLanes
    hit : (instance, triangle, distance, u, v)
    kind : int
        RAY_CAMERA, or RAY_DIFFUSE for a ray that has been scattered.
    """
    instance, triangle, distance, u, v = hit
    points, closures = lanes.points, lanes.closures
    error = prepare_point(scene.geometry, points, 0, instance, triangle, u, v, direction, 0.0)
    real, integer = points.real, points.integer
    real[0, POINT_RAY_LENGTH] = distance
    real[0, POINT_RADIUS] = 0.0
    real[0, POINT_RANDOM] = 0.5
    integer[0, POINT_PROGRAM] = program_of(scene.geometry, instance, triangle)
    integer[0, POINT_RAY_FLAGS] = kind
    evaluate_shaders(
        scene.shaders, scene.geometry, scene.tables, points, closures, lanes.first, 1, lanes.registers, MODE_CLOSURES
    )
    return error


@kernel
def is_receiver(closures):
    """Whether the camera is connected to what `shade` has found."""
    if summarize(closures, 0) & (HAS_DELTA | HAS_TRANSMISSION | HAS_TRANSPARENT) != 0:
        return False
    share, _ = rough_share(closures, 0, LEAST_ALPHA)
    return share >= 1.0


@kernel
def _hides(emitters, origin, direction, far):
    """Whether a lamp, or the sphere about an area lamp, is seen before the distance `far`."""
    for row in range(emitters.real.shape[0]):
        kind = emitters.integer[row, KIND]
        if kind != POINT and kind != AREA:
            continue
        middle = (emitters.real[row, MIDDLE], emitters.real[row, MIDDLE + 1], emitters.real[row, MIDDLE + 2])
        to_middle = subtract(middle, origin)
        along = dot(to_middle, direction)
        reach = emitters.reach[row]
        missed = dot(to_middle, to_middle) - along * along
        if missed < reach * reach and along > -reach and along - reach < far:
            return True
    return False


@kernel
def _glows(scene, hit):
    program = program_of(scene.geometry, hit[0], hit[1])
    return program >= 0 and scene.shaders.programs[program, PROGRAM_FLAGS] & PROGRAM_HAS_EMISSION != 0


@kernel
def sees_glow(scene, lanes, film_x, film_y):
    """Whether the camera sees a surface that glows at a place of the film [pixels]."""
    origin, direction, near, far, _radius, _spread = generate_ray(
        scene.camera, scene.camera_motion, film_x, film_y, 0.5, 0.5, 0.0
    )
    found = trace_closest(
        scene.handle[0], lanes.ray, lanes.bits, lanes.address[0], origin, direction, near, far, 0.0, VISIBLE_CAMERA
    )
    return found and _glows(scene, read_hit(lanes.ray, lanes.bits, scene.geometry))


@kernel
def look(scene, lanes, emitters, film_x, film_y):
    """Whether the camera sees a receiver that does not glow, and no lamp before it, at a place of the film [pixels]."""
    origin, direction, near, far, _radius, _spread = generate_ray(
        scene.camera, scene.camera_motion, film_x, film_y, 0.5, 0.5, 0.0
    )
    found = trace_closest(
        scene.handle[0], lanes.ray, lanes.bits, lanes.address[0], origin, direction, near, far, 0.0, VISIBLE_CAMERA
    )
    if not found:
        return False
    hit = read_hit(lanes.ray, lanes.bits, scene.geometry)
    if _glows(scene, hit):
        return False
    shade(scene, lanes, hit, direction, RAY_CAMERA)
    return is_receiver(lanes.closures) and not _hides(emitters, origin, direction, hit[2])


@kernel
def find_known(scene, lanes, emitters, known):
    """Write 1 to uint8 `known` (height, width), row 0 at the bottom, where all of a pixel's footprint is receivers.

    What glows may be so bright that a tail of the filter, where no sample is expected, has more of it than of the rest:
    so it is looked for all over the filter.
    """
    step, span = 1.0 / np.float32(_LOOKS), 2.0 * scene.filter_radius[0]
    for row in range(known.shape[0]):
        for column in range(known.shape[1]):
            sees = True
            for k in range(_LOOKS * _LOOKS):
                if not sees:
                    break
                dx = sample_table(scene.pixel_filter, (np.float32(k % _LOOKS) + 0.5) * step)
                dy = sample_table(scene.pixel_filter, (np.float32(k // _LOOKS) + 0.5) * step)
                sees = look(scene, lanes, emitters, np.float32(column) + 0.5 + dx, np.float32(row) + 0.5 + dy)
                if sees:
                    dx = span * ((np.float32(k % _LOOKS) + 0.5) * step - 0.5)
                    dy = span * ((np.float32(k // _LOOKS) + 0.5) * step - 0.5)
                    sees = not sees_glow(scene, lanes, np.float32(column) + 0.5 + dx, np.float32(row) + 0.5 + dy)
            known[row, column] = 1 if sees else 0
