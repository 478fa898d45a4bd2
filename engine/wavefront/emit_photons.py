# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages that send photons off: each from a place on a caster, with the light of a light sample there.

The place is drawn by area, and its light as any receiver's is: by the light tree, programs of lights and shadow rays.
What comes of it is what arrives there from one direction, and that is where the photon comes from.

References: Jensen 1996, "Global Illumination Using Photon Maps" (caustic photons, sent towards specular surfaces).
"""

import math

import numpy as np

from engine.kernels.bsdf import reset_closures
from engine.kernels.bsdf.closures import append_closure
from engine.kernels.bsdf.kinds import DIFFUSE
from engine.kernels.caster_pieces import place_in_piece
from engine.kernels.caustics import LEAST_COSINE, UNMET, rays_find
from engine.kernels.path import real_3
from engine.kernels.path_depths import reset_depths
from engine.kernels.photon_motion import density_of_start
from engine.kernels.rng import SET_FILTER_LENS, SET_TIME, SETS_BEFORE_VERTICES, pixel_hash, sample_4d
from engine.kernels.spectrum import start_wavelengths
from engine.kernels.surface import offset_origin, prepare_point, surface_point
from engine.kernels.vector import dot, load, negate, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_WEIGHT,
    LIGHT_USES_MIS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    RAY_DIFFUSE,
    RAY_DIFFUSE_ANCESTOR,
    RAY_REFLECT,
    RGB,
)
from engine.state.lights import (
    EMITTER_KIND,
    EMITTER_LAMP,
    LAMP_FLAG_DELTA,
    LAMP_FLAGS,
    LIGHT_BACKGROUND,
    LIGHT_TRIANGLE,
)
from engine.wavefront.columns import (
    NEXT_PATH,
    UNIT_PATH_COUNT,
    UNIT_SAMPLE_FIRST,
    UNIT_SEED,
    UNIT_SPLITS_LIGHT,
)

#: Makes of a render's seed that of its photons.
_SEED = np.uint32(0x7F0703A5)
_PI = np.float32(math.pi)
#: Surfaces that photons begin at are seen as those behind a diffuse bounce are.
_FLAGS = RAY_DIFFUSE | RAY_DIFFUSE_ANCESTOR | RAY_REFLECT
#: Longest ray that shaders are told of [m].
_LONGEST = np.float32(1e10)


@kernel
def _draw_row(cumulative, u):
    """The piece whose part of [0, 1) `u` lies in."""
    low, high = 0, cumulative.shape[0] - 1
    while low < high:
        middle = (low + high) // 2
        if cumulative[middle] > u:
            high = middle
        else:
            low = middle + 1
    return low


@kernel
def _begin_lane(paths, passes, lane, time, sample, rng, power):
    """A path that has met nothing yet."""
    paths.pixel[lane] = 0
    paths.sample[lane] = sample
    paths.rng[lane] = rng
    paths.dimension[lane] = SETS_BEFORE_VERTICES
    paths.time[lane] = time
    for c in range(len(paths.channels)):
        paths.throughput[lane, c] = power
        paths.radiance[lane, c] = 0.0
    paths.unguided[lane] = 1.0
    paths.survival[lane] = 1.0
    paths.unguided_survival[lane] = 1.0
    paths.mis_pdf[lane] = 0.0
    paths.unguided_pdf[lane] = -1.0
    paths.min_pdf[lane] = 1e30
    paths.mis_distance[lane] = 0.0
    paths.radius[lane] = 0.0
    paths.spread[lane] = 0.0
    paths.alpha[lane] = 1.0
    paths.flags[lane] = _FLAGS
    paths.alive[lane] = 1
    reset_depths(paths, lane)
    if passes.parts.shape[0] > 0:
        passes.is_open[lane] = 0


@kernel
def place_photons(scene, unit, work, queue):
    """Put places on one side of casters into lanes, as white surfaces that ask for light.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`, filled with as many of the unit's next photons as there are lanes, and `work.surface` too.
    """
    casters, grid, geometry, header = scene.casters, scene.photons, scene.geometry, unit.header
    paths, points, closures = work.paths, work.points, work.closures
    rng = pixel_hash(np.uint32(header[UNIT_SEED]) ^ _SEED, 0, 0)
    first, count = work.counts[NEXT_PATH], header[UNIT_PATH_COUNT]
    placed = min(count - first, np.int64(queue.lanes.shape[0]))
    for lane in range(placed):
        sample = header[UNIT_SAMPLE_FIRST] + first + lane
        u0, u1, u2, u3 = sample_4d(rng, sample, SET_FILTER_LENS)
        # At any time alike, so that no time is without photons that the camera sees little of.
        time, hero, _, _ = sample_4d(rng, sample, SET_TIME)
        # More bits than one number has: there may be millions of pieces.
        start = _draw_row(grid.cumulative, np.float64(u0) + np.float64(u3) * 2.0**-24)
        piece = start >> 1
        row = casters.row[piece]
        instance, triangle = np.int64(casters.instance[row]), np.int64(casters.triangle[row])
        root = math.sqrt(u1)
        u, v = np.float32(1.0 - root), np.float32(u2 * root)
        u, v = place_in_piece(piece - np.int64(casters.first_piece[row]), casters.level[row], u, v)
        density = density_of_start(scene, start, instance, triangle, time)
        p, ng, _ns, _error = surface_point(geometry, instance, triangle, u, v, time)
        if start & 1:
            ng = negate(ng)
        _begin_lane(paths, work.passes, lane, time, sample, rng, np.float32(1.0) / density)
        if len(paths.channels) > RGB:
            start_wavelengths(scene.spectrum, paths, lane, hero)
        work.photons.place_density[lane] = density
        work.photons.start[lane] = start
        # Seen from the side that asks.
        error = prepare_point(geometry, points, lane, instance, triangle, u, v, negate(ng), time)
        paths.offset[lane] = error
        # For who asks what media are there.
        store(paths.origin, lane, offset_origin(p, ng, ng, error))
        store(paths.direction, lane, negate(ng))
        paths.hit_distance[lane] = paths.reach[lane] = 0.0
        paths.hit_u[lane] = u
        paths.hit_v[lane] = v
        paths.hit_instance[lane] = instance
        paths.hit_triangle[lane] = triangle
        ns = real_3(points, lane, POINT_NS)
        reset_closures(closures, lane, ns, 0)
        # Its value is the cosine.
        append_closure(closures, lane, DIFFUSE, (_PI, _PI, _PI), ns)
        for c in range(RGB, len(paths.channels)):
            closures.param[lane, 0, CLOSURE_WEIGHT + c] = _PI
        work.log.count[lane] = 0
        work.log.is_recording[lane] = 0
        work.guided.rough_share[lane] = 0.0
        work.samples.guide_pdf[lane] = 0.0
        work.samples.weight[lane] = 1.0
        # Scattering finds nothing here: light samples count whole.
        work.samples.bsdf_share[lane] = 0.0
        queue.lanes[lane] = work.surface.lanes[lane] = lane
    queue.count[0] = work.surface.count[0] = placed
    work.counts[NEXT_PATH] = first + placed


@kernel
def _is_delta(lights, emitter):
    """Whether an emitter is a lamp without a size."""
    kind = lights.emitters[emitter, EMITTER_KIND]
    if kind == LIGHT_TRIANGLE or kind == LIGHT_BACKGROUND:
        return False
    row = np.int64(lights.emitters[emitter, EMITTER_LAMP])
    return lights.lamp_table[row, LAMP_FLAGS] & LAMP_FLAG_DELTA != 0


@kernel
def launch_photons(scene, unit, work, queue):
    """Make photons of the light that has arrived at their places, which they meet next.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`; `work.traced` is filled with the lanes of those that have light.
    """
    paths, points, samples, photons, lights = work.paths, work.points, work.samples, work.photons, scene.lights
    splits_light = unit.header[UNIT_SPLITS_LIGHT] != 0 and work.passes.parts.shape[0] > 0
    lanes, lane_count = queue.lanes, queue.count[0]
    traced, traced_count = work.traced.lanes, 0
    for k in range(lane_count):
        lane = lanes[k]
        samples.bsdf_share[lane] = 1.0
        largest = 0.0
        for c in range(len(paths.channels)):
            power = paths.radiance[lane, c]
            paths.radiance[lane, c] = 0.0
            paths.throughput[lane, c] = power
            largest = max(largest, abs(power))
        # Lamps that are to be found by light samples alone cast no caustics, as in Cycles, unless they have no size.
        emitter = np.int64(samples.emitter[lane])
        uses_mis = samples.flags[lane] & LIGHT_USES_MIS != 0
        is_met = uses_mis and rays_find(lights, emitter)
        if not largest > 0.0 or not math.isfinite(largest) or not (uses_mis or _is_delta(lights, emitter)):
            paths.alive[lane] = 0
            continue
        wi = load(samples.direction, lane)
        ns, ng = real_3(points, lane, POINT_NS), real_3(points, lane, POINT_NG)
        cosine = dot(ns, wi)
        if not cosine > LEAST_COSINE or not dot(ng, wi) > 0.0:
            paths.alive[lane] = 0
            continue
        # Light arrives by the cosine to the geometric normal.
        factor = dot(ng, wi) / cosine
        for c in range(len(paths.channels)):
            paths.throughput[lane, c] *= factor
        photons.density[lane] = samples.pdf[lane] * photons.place_density[lane] / cosine if is_met else UNMET
        photons.visibility[lane] = samples.visibility[lane]
        photons.group[lane] = work.passes.group[lane] if splits_light else -1
        store(paths.direction, lane, negate(wi))
        store(paths.origin, lane, real_3(points, lane, POINT_P))
        paths.hit_distance[lane] = min(samples.distance[lane], _LONGEST)
        traced[traced_count] = lane
        traced_count += 1
    work.traced.count[0] = traced_count


@kernel
def follow_photons(scene, unit, work, queue):
    """Find the photons that have not ended.

    Parameters
    ----------
    queue : LaneQueue
        `work.active`; `work.traced` is filled with the lanes whose rays are to be traced.
    """
    paths = work.paths
    lanes, lane_count = queue.lanes, queue.count[0]
    traced, traced_count = work.traced.lanes, 0
    for k in range(lane_count):
        lane = lanes[k]
        if paths.alive[lane] == 0 or paths.hit_instance[lane] < 0:
            continue
        paths.survival[lane] = 1.0
        traced[traced_count] = lane
        traced_count += 1
    work.traced.count[0] = traced_count
    work.surface.count[0] = 0
