# SPDX-License-Identifier: GPL-3.0-or-later
"""Nodes that trace rays while a surface's program runs: Ambient Occlusion, Bevel and Raycast.

The interpreter calls `trace_op` through a pointer (`engine.state.shaders.ShaderMemory`), which is linked, and compiled,
only where a material has such nodes. All is as in Cycles: rays do not meet the triangle that is shaded;
light samples, shadow rays, displacement and volumes trace none.
"""

from __future__ import annotations

import numpy as np

from engine.accel.local_rays import leave_triangle, read_local, to_mesh_space, trace_local_from
from engine.accel.masks import MASK_MEDIUM, MASK_RAYCAST, MASK_SHADOW_OPAQUE, MASK_SHADOW_TRANSPARENT
from engine.accel.ray_words import HIT_NORMAL
from engine.accel.rays import read_hit, trace_closest_from, trace_occluded, trace_occluded_from
from engine.accel.skipped_triangles import start_on
from engine.kernels.bsdf.normals import safe_normal
from engine.kernels.bsdf.warp import sample_cosine_hemisphere
from engine.kernels.disk_sampling import aim_probe, axis_weight, sample_cubic
from engine.kernels.memory import read3, write3
from engine.kernels.motion import normal_to_world
from engine.kernels.rng import SET_NODE_RAYS, sample_4d
from engine.kernels.shader.ops_rays import (
    OCCLUSION_INSIDE,
    OCCLUSION_LOCAL,
    OCCLUSION_OF_WORLD,
    OP_BEVEL,
    OP_OCCLUSION,
    write_missed,
    write_occlusion,
    write_raycast,
)
from engine.kernels.shader.surface import footprint_axis, read_point
from engine.kernels.surface import behind, offset_origin, ray_start, surface_point
from engine.kernels.vector import add, dot, negate, normalize, scale, subtract
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.state.geometry import INSTANCE_FLAG_BAKED, INSTANCE_FLAGS, INSTANCE_MESH, MESH_SHAPE, SHAPE_TRIANGLES
from engine.state.lanes import (
    POINT_FLAG_BACKFACING,
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RADIUS,
    POINT_TIME,
    POINT_TRIANGLE,
    PathState,
)

#: What occludes: all that casts shadows, however transparent it is, and boundaries of media.
_OCCLUDERS = MASK_SHADOW_OPAQUE | MASK_SHADOW_TRANSPARENT | MASK_MEDIUM
#: Behind a scattering that was less dense nothing is rounded (Cycles) [sr^-1].
_LEAST_PDF = np.float32(8.0)
#: Sets of random numbers between two nodes: more than the vertices of a path take.
_SETS_OF_NODE = 1 << 13
#: Places on a line that are looked at.
_MOST_HITS = 64
#: By so much of the shift of a bumped point its ray starts farther off (Cycles).
_BEYOND_SHIFT = np.float32(1.1)


class NodeRays(Bundle):
    """What rays of nodes need, for `trace_op`.

    scene : int64 (1,), Embree's
    local_scenes : int64 (I,), `engine.accel.local_rays.build_local_scenes`
    distance : float32 (1,), how far Ambient Occlusion looks where the node leaves that to the world [m]
    ray, ray_bits, ray_address : as in `engine.wavefront.work.Work`
    paths : PathState, of the lanes whose points are shaded
    """

    scene: np.ndarray
    local_scenes: np.ndarray
    distance: np.ndarray
    ray: np.ndarray
    ray_bits: np.ndarray
    ray_address: np.ndarray
    paths: PathState


@kernel
def _random(rays, lane, number, k, count):
    """Numbers of ray `k` of `count` of a node: those of all samples of a pixel are one sequence."""
    paths = rays.paths
    dimension = paths.dimension[lane] + SET_NODE_RAYS + _SETS_OF_NODE * number
    return sample_4d(paths.rng[lane], paths.sample[lane] * count + k, dimension)


@kernel
def _local_scene(rays, instance):
    """Embree's scene of an instance alone, 0 where there is none."""
    if instance >= rays.local_scenes.shape[0]:
        return np.int64(0)
    return rays.local_scenes[instance]


@kernel
def _leave(rays, geometry, points, lane, direction):
    """Where a ray starts that leaves the point."""
    p, instance = read_point(points, lane, POINT_P), points.integer[lane, POINT_INSTANCE]
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_IN_PLACE:
        return ray_start(
            geometry, instance, points.integer[lane, POINT_TRIANGLE], p, direction, points.real[lane, POINT_TIME]
        )
    return offset_origin(p, read_point(points, lane, POINT_NG), direction, rays.paths.offset[lane])


@kernel
def _meets_own(rays, geometry, instance, origin, direction, near, far, time, triangle):
    """Whether a ray meets the instance, but for a triangle (-1: none); `read_local` reads the answer."""
    handle = _local_scene(rays, instance)
    if handle == 0:
        return False
    at, along = to_mesh_space(geometry, instance, time, origin, direction)
    leave_triangle(rays.ray_bits, geometry, instance, triangle)
    return trace_local_from(handle, rays.ray, rays.ray_bits, rays.ray_address[0], at, along, near, far, time)


@kernel
def _free_part(rays, geometry, points, lane, normal, distance, count, flags, number):
    """Part of the rays into the cosine-weighted hemisphere about a normal that meet nothing."""
    instance, triangle = points.integer[lane, POINT_INSTANCE], points.integer[lane, POINT_TRIANGLE]
    if flags & OCCLUSION_OF_WORLD:
        distance = rays.distance[0]
    # Written so that what is no number traces nothing.
    if not distance > 0.0 or instance < 0 or count < 1:
        return np.float32(1.0)
    n, time = safe_normal(normal, read_point(points, lane, POINT_NS)), points.real[lane, POINT_TIME]
    if flags & OCCLUSION_INSIDE:
        n = negate(n)
    ray, bits, address, handle = rays.ray, rays.ray_bits, rays.ray_address[0], rays.scene[0]
    free = 0
    is_in_place = points.integer[lane, POINT_FLAGS] & POINT_FLAG_IN_PLACE != 0
    if is_in_place:
        start_on(bits, geometry, instance, triangle)
    for k in range(count):
        u, v, _, _ = _random(rays, lane, number, k, count)
        direction, _ = sample_cosine_hemisphere(n, u, v)
        origin = _leave(rays, geometry, points, lane, direction)
        if flags & OCCLUSION_LOCAL:
            is_hit = _meets_own(rays, geometry, instance, origin, direction, 0.0, distance, time, triangle)
        elif is_in_place:
            is_hit = trace_occluded_from(handle, ray, bits, address, origin, direction, 0.0, distance, time, _OCCLUDERS)
        else:
            # Off the surface there is nothing to skip, and no filter function to call.
            is_hit = trace_occluded(handle, ray, bits, address, origin, direction, 0.0, distance, time, _OCCLUDERS)
        if not is_hit:
            free += 1
    return np.float32(free) / np.float32(count)


@kernel
def _normals_along(rays, geometry, instance, p, probe, radius, time):
    """Sum of the normals where a probe meets the instance, by the profile over how likely probes are to meet them."""
    bits, near = rays.ray_bits, np.float32(0.0)
    at, along = to_mesh_space(geometry, instance, time, probe.origin, negate(probe.axis))
    total = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    own = 1.0 - probe.distance / radius
    if not own > 0.0:
        return total
    leave_triangle(bits, geometry, instance, -1)
    for _ in range(_MOST_HITS):
        if not trace_local_from(
            rays.local_scenes[instance], rays.ray, bits, rays.ray_address[0], at, along, near, probe.length, time
        ):
            break
        triangle, distance, u, v = read_local(rays.ray, bits, geometry, instance)
        leave_triangle(bits, geometry, instance, triangle)
        near = distance + behind(distance)
        hit, ng, ns, _ = surface_point(geometry, instance, triangle, u, v, time)
        apart = subtract(hit, p)
        left = 1.0 - np.sqrt(dot(apart, apart)) / radius
        if left > 0.0:
            # Both profiles, (1 - r / radius)^3, have the same norm.
            part = left / own
            total = add(total, scale(ns, axis_weight(probe, ng) * part * part * part))
    return total


@kernel
def _rounded_normal(rays, geometry, points, lane, radius, count, number):
    """Mean normal of the object near the point, weighed by a cubic profile; its own where it has none near.

    References
    ----------
    King et al. 2013, "BSSRDF Importance Sampling": probes along one of three axes.
    """
    ns, instance = read_point(points, lane, POINT_NS), points.integer[lane, POINT_INSTANCE]
    if not (radius > 0.0 and radius < np.inf) or instance < 0 or count < 1 or rays.paths.min_pdf[lane] < _LEAST_PDF:
        return ns
    if _local_scene(rays, instance) == 0:
        return ns
    p, ng, time = read_point(points, lane, POINT_P), read_point(points, lane, POINT_NG), points.real[lane, POINT_TIME]
    tangent, bitangent = footprint_axis(ng, 1), footprint_axis(ng, 2)
    total = (np.float32(0.0), np.float32(0.0), np.float32(0.0))
    for k in range(count):
        u_axis, u_distance, _, _ = _random(rays, lane, number, k, count)
        probe = aim_probe(p, ng, tangent, bitangent, sample_cubic(u_distance) * radius, radius, u_axis)
        total = add(total, _normals_along(rays, geometry, instance, p, probe, radius, time))
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_BACKFACING:
        total = negate(total)
    return safe_normal(total, ns)


@kernel
def _hit_normal(rays, geometry, instance, triangle, u, v, direction, time):
    """Smooth normal of what a ray has met, on the side that it comes from."""
    mesh = geometry.instance_table[instance, INSTANCE_MESH]
    if geometry.mesh_table[mesh, MESH_SHAPE] == SHAPE_TRIANGLES:
        _, ng, ns, _ = surface_point(geometry, instance, triangle, u, v, time)
    else:
        ray = rays.ray
        ng = (ray[HIT_NORMAL], ray[HIT_NORMAL + 1], ray[HIT_NORMAL + 2])
        if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
            ng = normal_to_world(geometry, instance, time, ng)
        ng = normalize(ng)
        ns = ng
    return negate(ns) if dot(ng, direction) > 0.0 else ns


@kernel
def _cast(rays, code, pc, memory, geometry, points, lane):
    """OP_RAYCAST."""
    position, direction, length = read3(memory, code[pc + 9]), read3(memory, code[pc + 10]), memory[code[pc + 11]]
    own, time = points.integer[lane, POINT_INSTANCE], points.real[lane, POINT_TIME]
    size = dot(direction, direction)
    if not length > 0.0 or own < 0 or not (size > 0.0 and size < np.inf):
        write_missed(code, pc, memory)
        return
    p = read_point(points, lane, POINT_P)
    near, skipped = np.float32(0.0), -1
    if memory[code[pc + 12]] > 0.0:
        near = memory[code[pc + 12]] * points.real[lane, POINT_RADIUS] * _BEYOND_SHIFT
    elif position[0] == p[0] and position[1] == p[1] and position[2] == p[2]:
        skipped = points.integer[lane, POINT_TRIANGLE]
    ray, bits = rays.ray, rays.ray_bits
    if code[pc + 13] != 0:
        is_hit = _meets_own(rays, geometry, own, position, direction, near, length, time, skipped)
    else:
        start_on(bits, geometry, own if skipped >= 0 else -1, skipped)
        is_hit = trace_closest_from(
            rays.scene[0], ray, bits, rays.ray_address[0], position, direction, near, length, time, MASK_RAYCAST
        )
    if not is_hit:
        write_missed(code, pc, memory)
        return
    if code[pc + 13] != 0:
        triangle, distance, u, v = read_local(ray, bits, geometry, own)
        instance = np.int32(own)
    else:
        instance, triangle, distance, u, v = read_hit(ray, bits, geometry)
    normal = _hit_normal(rays, geometry, instance, triangle, u, v, direction, time)
    place = add(position, scale(direction, distance))
    hit = np.int32(instance), np.int32(triangle), u, v
    write_raycast(code, pc, memory, instance == own, distance, place, normal, hit)


@kernel
def trace_op(memory, rays, shaders, geometry, points, lane, pc):
    """Run the instruction at `pc` for the point of `lane`.

    Parameters
    ----------
    memory : ShaderMemory
    rays : NodeRays
    shaders : ShaderArrays
    geometry : GeometryArrays
    points : ShadePoints
    """
    code, floats = shaders.code, memory.floats
    opcode = code[pc]
    if opcode == OP_OCCLUSION:
        normal, distance = read3(floats, code[pc + 6]), floats[code[pc + 5]]
        free = _free_part(
            rays, geometry, points, lane, normal, distance, code[pc + 7], code[pc + 8], code[pc + 9]
        )
        write_occlusion(code, pc, floats, free)
    elif opcode == OP_BEVEL:
        ns = read_point(points, lane, POINT_NS)
        rounded = _rounded_normal(rays, geometry, points, lane, floats[code[pc + 3]], code[pc + 5], code[pc + 6])
        given = read3(floats, code[pc + 4])
        write3(floats, code[pc + 2], safe_normal(add(given, subtract(rounded, ns)), rounded))
    else:
        _cast(rays, code, pc, floats, geometry, points, lane)
