# SPDX-License-Identifier: GPL-3.0-or-later
"""The way of a photon from a lamp, connected to the camera at each receiver that it meets.

The picture is what Cycles' paths converge to, so what a photon brings is the adjoint of what these carry: radiance as
it is, without the square of the refractive index (Veach 1997, "Robust Monte Carlo Methods for Light Transport
Simulation", section 5.2), and BSDFs by shading normals (section 5.3).
"""

import math

import numpy as np

from benchmarks.light_tracing.emitters import POWER, emit, is_emitted, pick_emitter
from benchmarks.light_tracing.receivers import is_receiver, shade
from engine.accel.rays import read_hit, trace_closest, trace_occluded
from engine.kernels.bsdf import eval_bsdf, sample_bsdf
from engine.kernels.bsdf.evaluate import EVERY_KIND
from engine.kernels.path import real_3
from engine.kernels.surface import offset_origin
from engine.kernels.vector import dot, normalize, scale
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA
from engine.state.camera import (
    CAMERA_CLIP_END,
    CAMERA_CLIP_START,
    CAMERA_OFFSET_X,
    CAMERA_OFFSET_Y,
    CAMERA_SCALE_X,
    CAMERA_SCALE_Y,
)
from engine.state.lanes import (
    POINT_NG,
    POINT_NS,
    POINT_P,
    RAY_CAMERA,
    RAY_DIFFUSE,
    RAY_REFLECT,
    RAY_SINGULAR,
    RAY_TRANSPARENT,
)

#: Scatterings after which photons may be ended by chance, and their least probability to go on.
_BEFORE_ROULETTE, _LEAST_SURVIVAL = 4, np.float32(0.05)
#: Transparent surfaces that a photon passes at most, more or less.
_MOST_PASSED = 64
_FAR = np.float32(1e30)
#: Rays to the camera end this share of the way before it.
_BEFORE_CAMERA = np.float32(1.0 - 1e-5)


@kernel
def uniform(random):
    """A uniform number in [0, 1) of a generator.

    References: Steele et al. 2014, "Fast Splittable Pseudorandom Number Generators" (SplitMix64).
    """
    state = random[0] + np.uint64(0x9E3779B97F4A7C15)
    random[0] = state
    z = (state ^ (state >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float32(z >> np.uint64(40)) * np.float32(2.0**-24)


@kernel
def _filter_at(scene, offset):
    radius = scene.filter_radius[0]
    cells = scene.filter_density.shape[0]
    cell = int(math.floor((offset + radius) / (2.0 * radius) * np.float32(cells)))
    if cell < 0 or cell >= cells:
        return np.float32(0.0)
    return scene.filter_density[cell]


@kernel
def splat(scene, film, x, y, color):
    """Add what falls on a place of the film [pixels] to the pixels whose filter is there."""
    radius = scene.filter_radius[0]
    height, width = film.shape[0], film.shape[1]
    first_row, last_row = int(math.floor(y - radius - 0.5)), int(math.floor(y + radius + 0.5))
    first_column, last_column = int(math.floor(x - radius - 0.5)), int(math.floor(x + radius + 0.5))
    for row in range(max(first_row, 0), min(last_row + 1, height)):
        along_y = _filter_at(scene, y - np.float32(row) - 0.5)
        if along_y > 0.0:
            for column in range(max(first_column, 0), min(last_column + 1, width)):
                weight = along_y * _filter_at(scene, x - np.float32(column) - 0.5)
                for c in range(3):
                    film[row, column, c] += weight * color[c]


@kernel
def to_film(scene, p):
    """Where the camera sees a point: x, y [pixels], and its depth [m]; depth 0 where it does not."""
    matrix = scene.camera_motion
    d = (p[0] - matrix[0, 3], p[1] - matrix[0, 7], p[2] - matrix[0, 11])
    depth = -(d[0] * matrix[0, 2] + d[1] * matrix[0, 6] + d[2] * matrix[0, 10])
    if not (scene.camera[CAMERA_CLIP_START] < depth < scene.camera[CAMERA_CLIP_END]):
        return 0.0, 0.0, 0.0
    x = (d[0] * matrix[0, 0] + d[1] * matrix[0, 4] + d[2] * matrix[0, 8]) / depth
    y = (d[0] * matrix[0, 1] + d[1] * matrix[0, 5] + d[2] * matrix[0, 9]) / depth
    return (
        (x - scene.camera[CAMERA_OFFSET_X]) / scene.camera[CAMERA_SCALE_X],
        (y - scene.camera[CAMERA_OFFSET_Y]) / scene.camera[CAMERA_SCALE_Y],
        depth,
    )


@kernel
def connect(scene, lanes, hit, p, ng, wi, weight):
    """Add what a photon of `weight` from `wi` makes a receiver send to the camera.

    Radiance through the film's area is flux times BSDF times cosine over squared distance, times the solid angle of a
    unit of the film (Pharr et al. 2016, "Physically Based Rendering", 16.1.1).
    """
    x, y, depth = to_film(scene, p)
    radius = scene.filter_radius[0]
    if not depth > 0.0:
        return
    if x < -radius or y < -radius or x > lanes.film.shape[1] + radius or y > lanes.film.shape[0] + radius:
        return
    matrix = scene.camera_motion
    d = (matrix[0, 3] - p[0], matrix[0, 7] - p[1], matrix[0, 11] - p[2])
    distance = math.sqrt(dot(d, d))
    to_camera = scale(d, 1.0 / distance)
    cosine = dot(to_camera, ng)
    # Both sides are the same one: nothing shines through a receiver.
    if not cosine > 0.0:
        return
    error = shade(scene, lanes, hit, scale(to_camera, -1.0), RAY_CAMERA)
    eval_bsdf(lanes.closures, scene.tables, 0, to_camera, wi, ng, EVERY_KIND, lanes.value, 0)
    solid = distance / (depth * depth * depth * scene.camera[CAMERA_SCALE_X] * scene.camera[CAMERA_SCALE_Y])
    factor = cosine * solid / abs(dot(wi, ng))
    color = (
        weight[0] * lanes.value[0, 0] * factor, weight[1] * lanes.value[0, 1] * factor,
        weight[2] * lanes.value[0, 2] * factor,
    )  # fmt: skip
    if not max(color[0], color[1], color[2]) > 0.0:
        return
    origin = offset_origin(p, ng, to_camera, error)
    hidden = trace_occluded(
        scene.handle[0], lanes.ray, lanes.bits, lanes.address[0], origin, to_camera, 0.0, distance * _BEFORE_CAMERA,
        0.0, VISIBLE_CAMERA,
    )  # fmt: skip
    if not hidden:
        splat(scene, lanes.film, x, y, color)


@kernel
def scatter(scene, lanes, hit, ng, ns, wi):
    """Draw where a photon from `wi` goes on.

    Returns
    -------
    wo : 3-tuple, 0 where it ends; `lanes.value` has the factor on its weight
    compression : float32, share of that which is the square of refractive indices
    bounces : int, 0 where it goes straight through a Transparent BSDF
    """
    nowhere = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    u0, u1, u2 = uniform(lanes.random), uniform(lanes.random), uniform(lanes.random)
    value = lanes.value
    pdf, wo, label, _roughness, eta = sample_bsdf(lanes.closures, scene.tables, 0, wi, ng, u0, u1, u2, value, 0)
    compression = np.float32(1.0)
    if not pdf > 0.0:
        return nowhere, compression, 1
    if label & RAY_TRANSPARENT:
        for c in range(3):
            value[0, c] = value[0, c] / pdf
        return wo, compression, 0
    wo = normalize(wo)
    across = abs(dot(wo, ng)) / abs(dot(wi, ng))
    if label & RAY_SINGULAR:
        factor = across * abs(dot(wi, ns)) / abs(dot(wo, ns)) / pdf
        if not label & RAY_REFLECT:
            compression = 1.0 / (eta * eta)
            factor *= compression
    else:
        # The BSDF as a path from the camera sees it, which comes from there.
        shade(scene, lanes, hit, scale(wo, -1.0), RAY_DIFFUSE)
        eval_bsdf(lanes.closures, scene.tables, 0, wo, wi, ng, EVERY_KIND, value, 0)
        factor = across / pdf
        if not label & RAY_REFLECT:
            compression = 1.0 / (eta * eta)
    if not abs(factor) < 1e30:
        return nowhere, compression, 1
    for c in range(3):
        value[0, c] = value[0, c] * factor
    return wo, compression, 1


@kernel
def trace_photon(scene, lanes, emitters, share, most_bounces):
    """Follow one photon, whose power is `share` of its emitter's; returns how many surfaces it has met."""
    row, pmf = pick_emitter(emitters, uniform(lanes.random))
    u = (uniform(lanes.random), uniform(lanes.random), uniform(lanes.random), uniform(lanes.random))
    origin, direction = emit(emitters, row, u)
    real = emitters.real
    whole = share / pmf
    weight = (real[row, POWER] * whole, real[row, POWER + 1] * whole, real[row, POWER + 2] * whole)
    first = max(weight[0], weight[1], weight[2])
    compressed = np.float32(1.0)
    met = bounces = 0
    while bounces <= most_bounces and met <= most_bounces + _MOST_PASSED:
        found = trace_closest(
            scene.handle[0], lanes.ray, lanes.bits, lanes.address[0], origin, direction, 0.0, _FAR, 0.0, VISIBLE_ALL
        )
        if not found:
            break
        hit = read_hit(lanes.ray, lanes.bits, scene.geometry)
        error = shade(scene, lanes, hit, direction, RAY_DIFFUSE)
        p, ng = real_3(lanes.points, 0, POINT_P), real_3(lanes.points, 0, POINT_NG)
        ns = real_3(lanes.points, 0, POINT_NS)
        if met == 0 and not is_emitted(emitters, row, origin, direction, p):
            break
        met += 1
        wi = scale(direction, -1.0)
        if is_receiver(lanes.closures):
            connect(scene, lanes, hit, p, ng, wi, weight)
            shade(scene, lanes, hit, direction, RAY_DIFFUSE)
        wo, compression, bounced = scatter(scene, lanes, hit, ng, ns, wi)
        value = lanes.value
        weight = (weight[0] * value[0, 0], weight[1] * value[0, 1], weight[2] * value[0, 2])
        compressed *= compression
        brightest = max(weight[0], weight[1], weight[2])
        if not (dot(wo, wo) > 0.5 and brightest > 0.0):
            break
        bounces += bounced
        if met > _BEFORE_ROULETTE:
            survival = max(min(brightest / (first * compressed), np.float32(1.0)), _LEAST_SURVIVAL)
            if uniform(lanes.random) >= survival:
                break
            weight = scale(weight, 1.0 / survival)
        origin = offset_origin(p, ng, wo, error)
        direction = wo
    return met


@kernel
def trace_photons(scene, lanes, emitters, count, share, most_bounces):
    """Follow `count` photons; returns how many surfaces they have met."""
    met = 0
    for _ in range(count):
        met += trace_photon(scene, lanes, emitters, share, most_bounces)
    return met
