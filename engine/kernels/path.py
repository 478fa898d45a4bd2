# SPDX-License-Identifier: GPL-3.0-or-later
"""Sending a path on: ray, ray kind, depths and flags after a scattering, whoever chose the direction."""


from engine.kernels.bsdf import HAS_TRANSMISSION, summarize
from engine.kernels.constants import INFINITY
from engine.kernels.lights import finds_all, tree_flags, tree_of_receiver, tree_within
from engine.kernels.path_depths import count_collision, count_scattering, count_transparent
from engine.kernels.surface import offset_origin
from engine.kernels.vector import load, store
from engine.runtime.jit import kernel
from engine.state.lanes import (
    LIGHT_ENDS_IN_PLACE,
    LIGHT_IS_LAMP,
    POINT_FLAG_IN_PLACE,
    POINT_FLAGS,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RADIUS,
    RAY_CAMERA,
    RAY_CAUSTIC,
    RAY_DIFFUSE,
    RAY_DIFFUSE_ANCESTOR,
    RAY_GATHERED,
    RAY_GLOSSY,
    RAY_MIS_FINDS_ALL,
    RAY_MIS_HAD_TRANSMISSION,
    RAY_MIS_SKIP,
    RAY_REFLECT,
    RAY_SHADOW_IN_PLACE,
    RAY_SINGULAR,
    RAY_STARTS_ON,
    RAY_SUBSURFACE,
    RAY_TERMINATE_AFTER_TRANSPARENT,
    RAY_TERMINATE_ON_NEXT_SURFACE,
    RAY_TRANSMIT,
    RAY_TRANSPARENT,
    RAY_TRANSPARENT_BACKGROUND,
    RAY_TREE_MASK,
    RAY_VISIBILITY,
    RAY_VOLUME,
)

#: Everything a scattering clears before it sets its own.
_RESET = ~(
    RAY_VISIBILITY
    | RAY_REFLECT
    | RAY_SINGULAR
    | RAY_TRANSPARENT
    | RAY_MIS_SKIP
    | RAY_MIS_HAD_TRANSMISSION
    | RAY_MIS_FINDS_ALL
    | RAY_TRANSPARENT_BACKGROUND
    | RAY_STARTS_ON
    | RAY_SUBSURFACE
    | RAY_TREE_MASK
    | RAY_CAUSTIC
)

#: What a path below a surface is no more: a ray of the camera, or the same ray behind something transparent.
_SEEN = RAY_CAMERA | RAY_TRANSPARENT | RAY_TRANSPARENT_BACKGROUND | RAY_CAUSTIC | RAY_GATHERED


@kernel
def real_3(points, lane, column):
    """Three consecutive floats of a point."""
    return points.real[lane, column], points.real[lane, column + 1], points.real[lane, column + 2]


@kernel
def go_on(paths, lane, origin):
    """Let the ray begin anew at `origin`, behind what it has met: it stays the same ray, and ends where it would have
    ended."""
    distance = paths.hit_distance[lane]
    paths.mis_distance[lane] += distance
    paths.radius[lane] += distance * paths.spread[lane]
    paths.hit_distance[lane] = max(paths.reach[lane] - paths.mis_distance[lane], 0.0)
    paths.flags[lane] &= ~RAY_STARTS_ON
    store(paths.origin, lane, origin)


@kernel
def _leave(paths, points, lane, direction):
    """Where a ray starts that leaves a surface, and RAY_STARTS_ON if that is in place."""
    p = real_3(points, lane, POINT_P)
    if points.integer[lane, POINT_FLAGS] & POINT_FLAG_IN_PLACE:
        return p, RAY_STARTS_ON
    return offset_origin(p, real_3(points, lane, POINT_NG), direction, paths.offset[lane]), 0


@kernel
def pass_through(options, paths, points, lane):
    """Go on behind a transparent surface as the same ray: kind, MIS density and origin stay the last scattering's."""
    flags = paths.flags[lane] | RAY_TRANSPARENT
    if count_transparent(options, paths, lane):
        flags |= RAY_TERMINATE_ON_NEXT_SURFACE
    paths.flags[lane] = flags
    origin, starts_on = _leave(paths, points, lane, load(paths.direction, lane))
    go_on(paths, lane, origin)
    paths.flags[lane] |= starts_on


@kernel
def go_below(paths, lane):
    """Go in below the surface: no scattering that counts, but from here on the camera does not see the path."""
    paths.flags[lane] = (paths.flags[lane] & ~_SEEN) | RAY_SUBSURFACE


@kernel
def _set_ray(paths, points, lane, origin, wi, pdf, unguided_pdf):
    """The ray of a scattering, and what weighs the emitter that it meets.

    Parameters
    ----------
    origin : tuple of 3 float32, world [m]; wi : tuple of 3 float32, unit
    pdf, unguided_pdf : float32 [sr^-1]
        As `PathState` has them.
    """
    store(paths.origin, lane, origin)
    store(paths.direction, lane, wi)
    paths.hit_distance[lane] = paths.reach[lane] = INFINITY
    paths.radius[lane] = points.real[lane, POINT_RADIUS]
    paths.mis_pdf[lane] = pdf
    paths.unguided_pdf[lane] = unguided_pdf
    store(paths.mis_origin, lane, real_3(points, lane, POINT_P))
    store(paths.mis_normal, lane, real_3(points, lane, POINT_NS))
    paths.mis_distance[lane] = 0.0


@kernel
def scatter_path(options, lights, paths, points, closures, lane, wi, label, pdf, bsdf_pdf):
    """Leave the surface towards `wi`; the throughput is the caller's business.

    Parameters
    ----------
    wi : tuple of 3 float32, unit
    label : int, RAY_* bits as `sample_bsdf` returns them
    pdf : float32 [sr^-1], source density for MIS at the next emitter (a delta lobe's probability)
    bsdf_pdf : float32 [sr^-1], density of BSDF sampling, by which Filter Glossy blurs what follows, and clamping goes
    """
    origin, starts_on = _leave(paths, points, lane, wi)
    _set_ray(paths, points, lane, origin, wi, pdf, bsdf_pdf)
    # A delta lobe's density is infinite: it blurs nothing behind it.
    if not label & RAY_SINGULAR:
        paths.min_pdf[lane] = min(paths.min_pdf[lane], bsdf_pdf)

    ends = count_scattering(options, paths, lane, label)
    tree = tree_of_receiver(lights, paths.hit_instance[lane])
    flags = paths.flags[lane] & _RESET | starts_on | tree_flags(lights, tree)
    flags |= RAY_REFLECT if label & RAY_REFLECT else RAY_TRANSMIT
    if label & RAY_DIFFUSE:
        flags |= RAY_DIFFUSE | RAY_DIFFUSE_ANCESTOR
    elif label & RAY_SINGULAR:
        flags |= RAY_GLOSSY | RAY_SINGULAR | RAY_MIS_SKIP
    else:
        flags |= RAY_GLOSSY
    if summarize(closures, lane) & HAS_TRANSMISSION:
        flags |= RAY_MIS_HAD_TRANSMISSION
    if finds_all(lights, closures, lane, real_3(points, lane, POINT_NG)):
        flags |= RAY_MIS_FINDS_ALL
    if ends:
        flags |= RAY_TERMINATE_AFTER_TRANSPARENT
    paths.flags[lane] = flags


@kernel
def mark_shadow(paths, lane, in_place):
    """Say whether the lane's shadow ray starts and ends in place."""
    if in_place:
        paths.flags[lane] |= RAY_SHADOW_IN_PLACE
    else:
        paths.flags[lane] &= ~RAY_SHADOW_IN_PLACE


@kernel
def ends_on_light(paths, lane, light_flags):
    """Whether the lane's shadow ray ends at its light itself, flags LIGHT_*, and not a rounding error before it."""
    return paths.flags[lane] & RAY_SHADOW_IN_PLACE != 0 and light_flags & (LIGHT_ENDS_IN_PLACE | LIGHT_IS_LAMP) != 0


@kernel
def leave_collision(options, lights, paths, points, media, lane, wi, pdf, phase_pdf):
    """Go on from a point within a medium towards `wi`; the throughput is the caller's business.

    Parameters
    ----------
    media : MediaLanes
    wi : tuple of 3 float32, unit
    pdf : float32 [sr^-1], by which the emitter that is met next is weighed
    phase_pdf : float32 [sr^-1], of the phase functions, by which Filter Glossy blurs what follows
    """
    # Light samples are taken on every segment, collisions happen on some.
    source_pdf = pdf * media.collision_share[lane]
    unguided_pdf = -1.0 if media.is_lit[lane] != 0 else phase_pdf * media.collision_share[lane]
    _set_ray(paths, points, lane, real_3(points, lane, POINT_P), wi, source_pdf, unguided_pdf)
    paths.min_pdf[lane] = min(paths.min_pdf[lane], phase_pdf)
    flags = (paths.flags[lane] & _RESET & ~RAY_GATHERED) | RAY_VOLUME | RAY_MIS_HAD_TRANSMISSION
    flags |= tree_flags(lights, tree_within(lights, media, lane))
    if count_collision(options, paths, media, lane):
        flags |= RAY_TERMINATE_AFTER_TRANSPARENT
    paths.flags[lane] = flags
