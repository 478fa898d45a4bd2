# SPDX-License-Identifier: GPL-3.0-or-later
"""Stages: paths that go in below a surface come out elsewhere, as from a diffuse surface. Run only where some can.

A path is scattered until it meets the surface that it has entered from inside, or crosses to where a profile says;
nothing but that instance is there for it, as in Cycles. The hit is that of the next round, which shades it like any
other.
"""

import math

import numpy as np

from engine.accel.local_rays import leave_triangle, read_local, to_mesh_space, trace_local, trace_local_from
from engine.kernels.bsdf.closures import append_closure, read3
from engine.kernels.bsdf.kinds import DIFFUSE
from engine.kernels.bsdf.microfacet import sample_ggx_normal
from engine.kernels.bsdf.phase import henyey_greenstein
from engine.kernels.bsdf.subsurface import (
    BURLEY,
    RANDOM_WALK,
    RANDOM_WALK_SKIN,
    SUBSURFACE_ALBEDO,
    SUBSURFACE_ALPHA,
    SUBSURFACE_G,
    SUBSURFACE_IOR,
    SUBSURFACE_METHOD,
    SUBSURFACE_RADIUS,
    SUBSURFACE_SCALE,
    exit_normal,
)
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.disk_sampling import axis_weight, burley_density, choose_probe
from engine.kernels.path import go_below, real_3
from engine.kernels.prefetch import ask_for_closures, ask_for_point, ask_for_ray, ask_for_throughput, lane_ahead
from engine.kernels.random_walk import (
    MOST_STEPS,
    Entry,
    Ways,
    backward_share,
    begin_walk,
    diffusion_length,
    direction_about,
    guided_fraction,
    medium_of_step,
    pick_channel,
    scatter_by_phase,
    towards_densities,
    towards_surface,
    walk_4,
    weigh_step,
)
from engine.kernels.rng import SET_SUBSURFACE, track_4
from engine.kernels.surface import surface_point
from engine.kernels.vector import (
    add,
    dot,
    negate,
    normalize,
    orthonormal_basis,
    scale,
    store,
    subtract,
    to_local,
    to_world,
)
from engine.runtime.jit import kernel
from engine.state.lanes import (
    CLOSURE_CHANNELS,
    CLOSURE_N,
    POINT_FLAG_BACKFACING,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_WO,
    RAY_SUBSURFACE,
)
from engine.state.walks import WALK_EXTINCTION, WALK_HIT, WALK_THROUGHPUT

#: Walks that have less left end (Cycles).
_LEAST_THROUGHPUT = np.float32(1e-6)
#: In mean free paths of the channel that goes farthest: an opposite side within is near.
_NEAR = np.float32(10.0)
#: Places on a line that are looked at.
_MOST_HITS = 64
_FOUR_PI = np.float32(4.0 * math.pi)


@kernel
def _enter(param, lane, i, wo, u0, u1):
    """Direction into the medium, unit; False: there is none.

    By refraction at a facet, or half of skin's light evenly. Nothing is weighed: as in Cycles, the direction is what
    matters, and all light goes in.
    """
    n = read3(param, lane, i, CLOSURE_N)
    if param[lane, i, SUBSURFACE_METHOD] == RANDOM_WALK_SKIN:
        if u0 < 0.5:
            inwards, _ = sample_cosine_hemisphere(negate(n), 2.0 * u0, u1)
            return inwards, True
        u0 = 2.0 * u0 - 1.0
    if dot(n, wo) <= 0.0:
        return wo, False
    alpha = param[lane, i, SUBSURFACE_ALPHA]
    tangent, bitangent = orthonormal_basis(n)
    h = to_world(sample_ggx_normal(to_local(wo, tangent, bitangent, n), alpha, alpha, u0, u1), tangent, bitangent, n)
    eta = 1.0 / param[lane, i, SUBSURFACE_IOR]
    cos_h = dot(h, wo)
    cos_t = math.sqrt(max(1.0 - eta * eta * (1.0 - cos_h * cos_h), 1e-14))
    return normalize(subtract(scale(h, eta * cos_h - cos_t), scale(wo, eta))), True


@kernel
def _begin(paths, param, rows, lane, i):
    """Fill `rows` with the medium below the lane's lobe `i`; returns the mean cosine of its phase function."""
    method, g = param[lane, i, SUBSURFACE_METHOD], param[lane, i, SUBSURFACE_G]
    length = param[lane, i, SUBSURFACE_SCALE]
    for c in range(len(paths.channels)):
        rows[WALK_THROUGHPUT, c] = paths.throughput[lane, c]
        begin_walk(
            rows, c, param[lane, i, SUBSURFACE_ALBEDO + c], length * param[lane, i, SUBSURFACE_RADIUS + c], g,
            method != RANDOM_WALK,
        )
    return g


@kernel
def _turn(entry, p, direction, g, fraction, u_way, u1, u2):
    """Direction of a step behind the first, the factor on its extinction, and `Ways`.

    `fraction` of them are guided; `u_way` decides whether this one is, and which way.
    """
    backward = backward_share(entry, p)
    is_guided = u_way < fraction
    is_backward = is_guided and u_way < fraction * backward
    if is_guided:
        cosine = towards_surface(entry, u1)
        if is_backward:
            cosine = -cosine
        new = direction_about(entry.n, cosine, u2)
    else:
        new = scatter_by_phase(direction, g, u1, u2)
        cosine = dot(new, entry.n)
    inverse = _FOUR_PI if g == 0.0 else 1.0 / henyey_greenstein(dot(direction, new), g)
    towards, away = towards_densities(entry, cosine)
    part = cosine * entry.inverse_length
    forward, back = 1.0 - part, 1.0 + part
    ways = Ways(fraction, backward, towards * inverse, away * inverse, forward, back)
    stretch = np.float32(1.0)
    if is_guided:
        stretch = back if is_backward else forward
    return new, stretch, ways


@kernel
def _trace(scene, work, lane, p, direction, far, is_first):
    """How far along a ray the lane's instance is met; negative: farther than `far`."""
    geometry, paths = scene.geometry, work.paths
    ray, bits, address = work.ray, work.ray_bits, work.ray_address[0]
    instance, time = paths.hit_instance[lane], paths.time[lane]
    at, along = to_mesh_space(geometry, instance, time, p, direction)
    local = scene.local_scenes[instance]
    if is_first:
        leave_triangle(bits, geometry, instance, paths.hit_triangle[lane])
        is_hit = trace_local_from(local, ray, bits, address, at, along, 0.0, far, time)
    else:
        is_hit = trace_local(local, ray, bits, address, at, along, far, time)
    if not is_hit:
        return np.float32(-1.0)
    _, distance, _, _ = read_local(ray, bits, geometry, instance)
    return distance


@kernel
def _with_opposite(entry, direction, far):
    """`entry` with the opposite side, which the first ray has met at a distance."""
    depth = -dot(direction, entry.n) * far
    return Entry(entry.p, entry.n, entry.length, entry.inverse_length, entry.log_ratio, max(depth, 0.0))


@kernel
def _reach(channels, rows):
    """How far away an opposite side is near [m]."""
    least = rows[WALK_EXTINCTION, 0]
    for c in range(len(channels)):
        least = min(least, rows[WALK_EXTINCTION, c])
    return _NEAR / least


@kernel
def _walk(scene, work, lane, direction, g):
    """Walk until the surface is met, whose hit is then the last that Embree has found.

    Returns
    -------
    is_out : bool
    direction : tuple of 3 float32, in which it is met
    """
    paths, points, rows = work.paths, work.points, work.walks.real
    channels = paths.channels
    p = real_3(points, lane, POINT_P)
    length = diffusion_length(channels, rows)
    # Written so that NaN fails.
    if not length > 1.0:
        return False, direction
    log_ratio = math.log((length + 1.0) / (length - 1.0))
    entry = Entry(p, real_3(points, lane, POINT_NS), length, 1.0 / length, log_ratio, -1.0)
    ways = Ways(0.0, 0.0, 0.0, 0.0, 1.0, 1.0)
    dimension, guided = paths.dimension[lane] + SET_SUBSURFACE, guided_fraction(g)
    for step in range(MOST_STEPS):
        u0, u_distance, u1, u2 = walk_4(paths.rng[lane], paths.sample[lane], dimension, step)
        channel, u0 = pick_channel(channels, rows, u0)
        medium, g_now, fraction = medium_of_step(g, guided, step)
        stretch = np.float32(1.0)
        if step > 0:
            direction, stretch, ways = _turn(entry, p, direction, g_now, fraction, u0, u1, u2)
        t = -math.log(1.0 - u_distance) / (rows[medium, channel] * stretch)
        far = t
        if step == 0:
            far = max(t, _reach(channels, rows))
        distance = _trace(scene, work, lane, p, direction, far, step == 0)
        if step == 0 and distance >= 0.0:
            entry = _with_opposite(entry, direction, distance)
        is_exit = distance >= 0.0 and distance < t
        if is_exit:
            t = distance
        left = weigh_step(channels, rows, medium, t, is_exit, ways)
        if is_exit:
            return True, direction
        if not left >= _LEAST_THROUGHPUT:
            return False, direction
        p = add(p, scale(direction, t))
    return False, direction


@kernel
def _pick_radius(paths, param, rows, lane, i, u):
    """Write the channels' radii into WALK_EXTINCTION, and draw one, all alike; returns it, its share, and `u` left."""
    count = np.float32(0.0)
    for c in range(len(paths.channels)):
        radius = param[lane, i, SUBSURFACE_SCALE] * param[lane, i, SUBSURFACE_RADIUS + c]
        rows[WALK_EXTINCTION, c] = radius
        if radius > 0.0:
            count += 1.0
    rest = u * count
    picked = np.float32(0.0)
    for c in range(len(paths.channels)):
        if rows[WALK_EXTINCTION, c] > 0.0:
            picked = rows[WALK_EXTINCTION, c]
            if rest < 1.0:
                break
            rest -= 1.0
    return picked, 1.0 / count if count > 0.0 else np.float32(0.0), min(rest, ONE_MINUS_EPSILON)


@kernel
def _weigh_hit(channels, rows, share, probe, ng, r):
    """Write what a place at distance `r` that the probe has met lets out into WALK_HIT; returns the mean."""
    density = np.float32(0.0)
    for c in range(len(channels)):
        density += share * burley_density(rows[WALK_EXTINCTION, c], probe.distance)
    factor = axis_weight(probe, ng) / density if density > 0.0 else np.float32(0.0)
    mean = np.float32(0.0)
    for c in range(len(channels)):
        rows[WALK_HIT, c] = factor * burley_density(rows[WALK_EXTINCTION, c], r)
        mean += rows[WALK_HIT, c]
    return mean / np.float32(len(channels))


@kernel
def _cross(scene, work, lane, i):
    """Find where light comes out by Burley's profile: of the places on a line, one is drawn by what each lets out.

    Returns
    -------
    is_out : bool
    hit : (triangle, u, v)
    direction : tuple of 3 float32
        Outwards.
    """
    geometry, paths, points, rows = scene.geometry, work.paths, work.points, work.walks.real
    ray, bits, address = work.ray, work.ray_bits, work.ray_address[0]
    instance, time = paths.hit_instance[lane], paths.time[lane]
    dimension = paths.dimension[lane] + SET_SUBSURFACE
    u_radius, u_axis, u_pick, _ = track_4(paths.rng[lane], paths.sample[lane], dimension, 0)
    radius, share, u_radius = _pick_radius(paths, work.closures.param, rows, lane, i, u_radius)
    p, ng = real_3(points, lane, POINT_P), real_3(points, lane, POINT_NG)
    probe = choose_probe(p, ng, radius, u_radius, u_axis)
    at, along = to_mesh_space(geometry, instance, time, probe.origin, negate(probe.axis))
    is_back = points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING != 0
    near, total = np.float32(0.0), np.float32(0.0)
    triangle, u, v, outwards = paths.hit_triangle[lane], np.float32(0.0), np.float32(0.0), ng
    leave_triangle(bits, geometry, instance, -1)
    for _ in range(_MOST_HITS):
        if not trace_local_from(
            scene.local_scenes[instance], ray, bits, address, at, along, near, probe.length, time
        ):
            break
        hit_triangle, near, hit_u, hit_v = read_local(ray, bits, geometry, instance)
        leave_triangle(bits, geometry, instance, hit_triangle)
        hit, hit_ng, _, _ = surface_point(geometry, instance, hit_triangle, hit_u, hit_v, time)
        apart = subtract(hit, p)
        weight = _weigh_hit(paths.channels, rows, share, probe, hit_ng, math.sqrt(dot(apart, apart)))
        if not weight > 0.0:
            continue
        total += weight
        chance = weight / total
        if u_pick < chance:
            u_pick = u_pick / chance
            triangle, u, v = hit_triangle, hit_u, hit_v
            outwards = negate(hit_ng) if is_back else hit_ng
            for c in range(len(paths.channels)):
                rows[WALK_THROUGHPUT, c] = paths.throughput[lane, c] * rows[WALK_HIT, c] / weight
        else:
            u_pick = (u_pick - chance) / (1.0 - chance)
    for c in range(len(paths.channels)):
        rows[WALK_THROUGHPUT, c] *= total
    return total > 0.0, (triangle, u, v), outwards


@kernel
def _come_out(work, lane, hit, direction):
    """Make a place where light comes out the path's hit, as if it were seen from outside.

    Parameters
    ----------
    hit : (triangle, u, v)
    direction : tuple of 3 float32
        In which the path comes out.
    """
    paths = work.paths
    triangle, u, v = hit
    paths.hit_triangle[lane] = triangle
    paths.hit_u[lane] = u
    paths.hit_v[lane] = v
    store(paths.direction, lane, negate(direction))
    # What lies before has been passed: on a ray without length there is nothing to find.
    paths.mis_distance[lane] += paths.hit_distance[lane]
    paths.radius[lane] += paths.hit_distance[lane] * paths.spread[lane]
    paths.hit_distance[lane] = 0.0
    for c in range(len(paths.channels)):
        paths.throughput[lane, c] = work.walks.real[WALK_THROUGHPUT, c]


@kernel
def _go_below(scene, work, lane, i):
    """Where a path comes out that has gone in by the lane's lobe `i`: see `_cross`."""
    paths, points, param = work.paths, work.points, work.closures.param
    nothing = (paths.hit_triangle[lane], np.float32(0.0), np.float32(0.0))
    wo = real_3(points, lane, POINT_WO)
    if scene.local_scenes[paths.hit_instance[lane]] == 0:
        return False, nothing, wo
    if param[lane, i, SUBSURFACE_METHOD] == BURLEY:
        return _cross(scene, work, lane, i)
    direction, is_in = _enter(param, lane, i, wo, paths.random[lane, 1], paths.random[lane, 2])
    if not (is_in and dot(direction, real_3(points, lane, POINT_NG)) < 0.0):
        return False, nothing, wo
    g = _begin(paths, param, work.walks.real, lane, i)
    is_out, direction = _walk(scene, work, lane, direction, g)
    if not is_out:
        return False, nothing, wo
    triangle, _, u, v = read_local(work.ray, work.ray_bits, scene.geometry, paths.hit_instance[lane])
    return True, (triangle, u, v), direction


@kernel
def walk_subsurface(scene, unit, work, queue):
    """Take paths to where they come out again; those that do not have ended, and leave the queue.

    Parameters
    ----------
    queue : LaneQueue
        `work.walking`, whose closures are still those of the surface that they go in through.
    """
    paths, points, closures = work.paths, work.points, work.closures
    lanes, lane_count, kept = queue.lanes, queue.count[0], 0
    for k in range(lane_count):
        lane = lanes[k]
        ahead = lane_ahead(lanes, k, lane_count)
        ask_for_ray(paths, ahead)
        ask_for_throughput(paths, ahead)
        ask_for_point(points, ahead)
        ask_for_closures(closures, ahead)
        go_below(paths, lane)
        is_out, hit, direction = _go_below(scene, work, lane, work.walks.lobe[lane])
        if is_out:
            _come_out(work, lane, hit, direction)
            lanes[kept] = lane
            kept += 1
        else:
            paths.alive[lane] = 0
    queue.count[0] = kept


@kernel
def leave_subsurface(scene, unit, work, queue):
    """Make surfaces through which paths come out diffuse, whatever their shader has left: one that lets all through.

    Parameters
    ----------
    queue : LaneQueue
        `work.surface`, shaded.
    """
    paths, closures = work.paths, work.shaded
    lanes, lane_count = queue.lanes, queue.count[0]
    for k in range(lane_count):
        lane = lanes[k]
        if not paths.flags[lane] & RAY_SUBSURFACE:
            continue
        n = exit_normal(closures, lane)
        closures.count[lane] = 0
        closures.holdout[lane] = 0.0
        for c in range(CLOSURE_CHANNELS):
            closures.emission[lane, c] = 0.0
            closures.transparency[lane, c] = 0.0
        append_closure(closures, lane, DIFFUSE, (1.0, 1.0, 1.0), n)
