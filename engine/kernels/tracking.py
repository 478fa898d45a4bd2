# SPDX-License-Identifier: GPL-3.0-or-later
"""Following a ray through media that vary in space, by possible collisions at the rate of a bound on their density.

Each of several media that overlap collides at the rate of its own bound: only the chosen one has to be looked up.

References
----------
Woodcock et al. 1965, "Techniques used in the GEM code"; Novak et al. 2014, "Residual Ratio Tracking for Estimating
Attenuation in Participating Media"; Kutz et al. 2017, "Spectral and Decomposition Tracking for Rendering Heterogeneous
Volumes", section 5.1 (history-aware collision probabilities); Miller et al. 2019, "A Null-Scattering Path Integral
Formulation of Light Transport", section 5 (the same as MIS of channels).
"""

import math

import numpy as np

from engine.kernels.constants import INFINITY
from engine.kernels.motion import direction_to_object, point_to_object
from engine.kernels.path_depths import store_depths
from engine.kernels.spectrum import upsample_light
from engine.kernels.vector import add, scale
from engine.runtime.jit import kernel
from engine.state.geometry import VALUE_DENSITY
from engine.state.lanes import (
    CLOSURE_WEIGHT,
    POINT_FLAGS,
    POINT_INSTANCE,
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_PROGRAM,
    POINT_RADIUS,
    POINT_RANDOM,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TIME,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RGB,
)
from engine.state.media import (
    EMISSION,
    EXTINCTION,
    MEDIUM_ABSORPTION,
    MEDIUM_MAJORANT,
    MEDIUM_SCATTERING,
    SCATTERING,
    WORLD,
)
from engine.state.tracking import GRID_LOWER, GRID_MEDIUM, GRID_RESOLUTION, GRID_SCALE, WORLD_REACH, WORLD_UNIT

#: How far behind a boundary between cells the next one is looked up, in cells: further than rounding may err.
_BEYOND = np.float32(1e-4)
#: How much more than the largest channel of a colour its smooth spectrum has somewhere; more only if it is saturated.
_SPECTRAL_MARGIN = np.float32(1.5)
#: Cells that a ray may cross between two possible collisions.
_MOST_CELLS = 1 << 16
#: Share of the light from which on a ray is followed by chance.
_ROULETTE_BELOW = np.float32(0.1)
#: Possible collisions of a ray: one that has more is in something far too dense.
MOST_STEPS = 1 << 16

# What a ray does at a possible collision.
GOES_ON = 0
COLLIDES = 1
ENDS = 2


@kernel
def _within_cell(x, v, count):
    """Cell that a coordinate (in cells) is in, and how far it is out of it at a speed of `v` cells a metre [m].

    Outside of the grid the next cell goes on, to where the grid begins or for ever.
    """
    # Cut off, not rounded down: what is below 0 is in cell 0 either way.
    cell = min(max(int(x + math.copysign(_BEYOND, v)), 0), count - 1)
    leave = INFINITY
    if v > 0.0:
        leave = (np.float32(cell + 1) - x) / v
    elif v < 0.0:
        leave = (np.float32(cell) - x) / v
    return cell, leave if leave > 0.0 else INFINITY


@kernel
def _warped(x, count):
    """Cell coordinate of a coordinate of the world [m]: cells grow with their distance from the origin."""
    return 0.5 * np.float32(count) * (1.0 + np.float32(math.asinh(x / WORLD_UNIT)) / WORLD_REACH)


@kernel
def _within_world(x, d, count):
    """As `_within_cell`, of the world's grid and in metres; and whether the coordinate is in the grid."""
    place = _warped(x, count)
    cell = min(max(int(place + math.copysign(_BEYOND, d)), 0), count - 1)
    leave = INFINITY
    if d != 0.0:
        side = np.float32(cell + 1) if d > 0.0 else np.float32(cell)
        plane = WORLD_UNIT * np.float32(math.sinh((2.0 * side / np.float32(count) - 1.0) * WORLD_REACH))
        leave = (plane - x) / d
    return cell, leave if leave > 0.0 else INFINITY, 0.0 <= place <= np.float32(count)


@kernel
def _world_majorant(grids, row, p, d):
    """As `majorant_at`, of the world; there is nothing outside of its grid."""
    nx = grids.table[row, GRID_RESOLUTION]
    ny = grids.table[row, GRID_RESOLUTION + 1]
    nz = grids.table[row, GRID_RESOLUTION + 2]
    i, along_x, in_x = _within_world(p[0], d[0], nx)
    j, along_y, in_y = _within_world(p[1], d[1], ny)
    k, along_z, in_z = _within_world(p[2], d[2], nz)
    ahead = max(min(along_x, along_y, along_z), _BEYOND * (WORLD_UNIT + abs(p[0]) + abs(p[1]) + abs(p[2])))
    if not (in_x and in_y and in_z):
        return 0.0 * ahead, ahead
    return grids.values[grids.offset[row] + i + nx * (j + ny * np.int64(k))], ahead


@kernel
def _grid_of(grids, instance, medium):
    """The row of a medium's grid, -1: it has none there."""
    end = grids.first[instance + 2]
    for row in range(grids.first[instance + 1], end):
        if grids.table[row, GRID_MEDIUM] == medium:
            return row
    return -1


@kernel
def majorant_at(scene, instance, medium, origin, direction, time, t):
    """Bound on the extinction of a medium at a point of a ray, and how much further it holds.

    Returns
    -------
    majorant : float32 [m^-1]
    ahead : float32 [m], above 0
    """
    grids = scene.media.majorants
    if scene.media.program[medium] < 0:
        return scene.media.media[medium, MEDIUM_MAJORANT], INFINITY
    row = _grid_of(grids, instance, medium)
    if row < 0:
        return 0.0 * t, INFINITY
    p = add(origin, scale(direction, t))
    if instance == WORLD:
        return _world_majorant(grids, row, p, direction)
    p = point_to_object(scene.geometry, instance, time, p)
    d = direction_to_object(scene.geometry, instance, time, direction)
    x = (p[0] - grids.space[row, GRID_LOWER]) * grids.space[row, GRID_SCALE]
    y = (p[1] - grids.space[row, GRID_LOWER + 1]) * grids.space[row, GRID_SCALE + 1]
    z = (p[2] - grids.space[row, GRID_LOWER + 2]) * grids.space[row, GRID_SCALE + 2]
    v = (
        d[0] * grids.space[row, GRID_SCALE], d[1] * grids.space[row, GRID_SCALE + 1],
        d[2] * grids.space[row, GRID_SCALE + 2],
    )
    nx = grids.table[row, GRID_RESOLUTION]
    ny = grids.table[row, GRID_RESOLUTION + 1]
    nz = grids.table[row, GRID_RESOLUTION + 2]
    i, along_x = _within_cell(x, v[0], nx)
    j, along_y = _within_cell(y, v[1], ny)
    k, along_z = _within_cell(z, v[2], nz)
    fastest = max(abs(v[0]), abs(v[1]), abs(v[2]))
    ahead = min(along_x, along_y, along_z)
    if fastest > 0.0:
        ahead = max(ahead, _BEYOND / fastest)
    return grids.values[grids.offset[row] + i + nx * (j + ny * np.int64(k))], ahead


@kernel
def _axis(x, v, t, count):
    """Where a ray is along an axis of a grid, to be followed from cell to cell.

    Outside of the grid the next cell goes on, to where the grid begins or for ever.

    Parameters
    ----------
    x, v : float32
        Coordinate of the ray's start, in cells, and its speed, in cells a metre.
    t : float32 [m]
        How far along the ray.
    count : int
        Cells.

    Returns
    -------
    cell : int
    leave : float32 [m], where on the ray the cell ends
    step : float32 [m], how long the ray is in a cell
    last : float32 [m], behind this no cell ends that another one follows
    """
    # Cut off, not rounded down: what is below 0 is in cell 0 either way.
    cell = min(max(int(x + t * v + math.copysign(_BEYOND, v)), 0), count - 1)
    inverse = 1.0 / v if v != 0.0 else 0.0 * v
    ahead = count - 1 - cell if v > 0.0 else cell
    side = np.float32(cell + 1) if v > 0.0 else np.float32(cell)
    step = abs(inverse)
    leave = (side - x) * inverse
    last = leave + (np.float32(ahead) - 0.5) * step
    return cell, leave if v != 0.0 and ahead > 0 else INFINITY, step, last


@kernel
def _next_side(leave, step, last, t):
    """Where a ray at `t` leaves a cell along an axis; see `_axis`."""
    following = leave + step
    following = following if following < last else INFINITY
    return following if leave <= t else leave


@kernel
def _cross_grid(scene, instance, medium, origin, direction, time, t, end, depth, margin):
    """What `next_collision` does in the only grid that counts, which is none of the world's: the ray is put into the
    grid's space once, not at every cell.

    Parameters
    ----------
    depth : float32
        Optical depth, by the bounds, at which the ray may collide.
    margin : float32
        Factor on the bounds.

    Returns
    -------
    t : float32 [m]
    majorant : float32 [m^-1], 0: it reaches `end`
    """
    grids = scene.media.majorants
    none = 0.0 * t
    row = _grid_of(grids, instance, medium)
    if row < 0:
        return end, none
    p = point_to_object(scene.geometry, instance, time, origin)
    d = direction_to_object(scene.geometry, instance, time, direction)
    scale_x, scale_y = grids.space[row, GRID_SCALE], grids.space[row, GRID_SCALE + 1]
    scale_z = grids.space[row, GRID_SCALE + 2]
    start_x = (p[0] - grids.space[row, GRID_LOWER]) * scale_x
    start_y = (p[1] - grids.space[row, GRID_LOWER + 1]) * scale_y
    start_z = (p[2] - grids.space[row, GRID_LOWER + 2]) * scale_z
    vx, vy, vz = d[0] * scale_x, d[1] * scale_y, d[2] * scale_z
    nx, ny = grids.table[row, GRID_RESOLUTION], grids.table[row, GRID_RESOLUTION + 1]
    i, leave_x, step_x, last_x = _axis(start_x, vx, t, nx)
    j, leave_y, step_y, last_y = _axis(start_y, vy, t, ny)
    k, leave_z, step_z, last_z = _axis(start_z, vz, t, grids.table[row, GRID_RESOLUTION + 2])
    at = grids.offset[row] + i + nx * (j + ny * np.int64(k))
    stride_x = 1 if vx > 0.0 else -1
    stride_y = nx if vy > 0.0 else -nx
    stride_z = nx * ny if vz > 0.0 else -nx * ny
    for _ in range(_MOST_CELLS):
        bound = margin * grids.values[at]
        leave = min(max(min(leave_x, leave_y, leave_z), t), end)
        within = bound * (leave - t)
        if depth < within:
            return min(t + depth / bound, end), bound
        depth -= within
        t = leave
        if not t < end:
            break
        # Which side comes first is nothing that a processor could foresee: no branches.
        at += stride_x if leave_x <= t else 0
        at += stride_y if leave_y <= t else 0
        at += stride_z if leave_z <= t else 0
        leave_x = _next_side(leave_x, step_x, last_x, t)
        leave_y = _next_side(leave_y, step_y, last_y, t)
        leave_z = _next_side(leave_z, step_z, last_z, t)
    return end, none


@kernel
def _only_one(scene, media, row, uniform):
    """The entry of a row's media that takes part if that is one alone, and varies on an object; else -1."""
    only = -1
    for k in range(media.count[row]):
        if scene.media.program[media.medium[row, k]] < 0:
            if uniform:
                return -1
        elif only >= 0 or media.instance[row, k] == WORLD:
            return -1
        else:
            only = k
    return only


@kernel
def next_collision(scene, paths, media, row, origin, direction, time, t, end, u_distance, u_choice, uniform):
    """Where the media of a row may collide next, behind `t` and before `end`.

    Parameters
    ----------
    uniform : bool
        Whether those that are the same everywhere take part.

    Returns
    -------
    t : float32 [m]
    entry : int, of the row's media, -1: nowhere
    majorant : float32 [m^-1], of that medium
    """
    margin = _SPECTRAL_MARGIN if len(paths.channels) > RGB else 1.0
    depth = -math.log(1.0 - u_distance)
    only = _only_one(scene, media, row, uniform)
    if only >= 0:
        t, bound = _cross_grid(
            scene, media.instance[row, only], media.medium[row, only], origin, direction, time, t, end, depth, margin
        )
        return t, only if bound > 0.0 else -1, bound
    for _ in range(_MOST_CELLS):
        total = 0.0
        ahead = end - t
        for k in range(media.count[row]):
            if not uniform and scene.media.program[media.medium[row, k]] < 0:
                continue
            majorant, further = majorant_at(
                scene, media.instance[row, k], media.medium[row, k], origin, direction, time, t
            )
            total += margin * majorant
            ahead = min(ahead, further)
        if depth < total * ahead:
            rest = u_choice * total
            chosen = -1
            bound = 0.0
            for k in range(media.count[row]):
                if not uniform and scene.media.program[media.medium[row, k]] < 0:
                    continue
                majorant, _further = majorant_at(
                    scene, media.instance[row, k], media.medium[row, k], origin, direction, time, t
                )
                if majorant > 0.0:
                    chosen = k
                    bound = margin * majorant
                    if rest < bound:
                        break
                    rest -= bound
            return min(t + depth / total, end), chosen, bound
        depth -= total * ahead
        t += ahead
        if not t < end:
            break
    return end, -1, 0.0


@kernel
def place_in_medium(
    paths, lane, points, row, instance, program, p, direction, distance, flags, transparent_depth
):
    """Set row `row` of `points` to a point within a medium.

    Parameters
    ----------
    paths : PathState; lane : int
        The path, whose time and depths count.
    distance : float32 [m]
        From the ray's start.
    flags : int, RAY_*
    transparent_depth : int
        Surfaces that the ray has passed.
    """
    real, integer = points.real, points.integer
    for c in range(3):
        real[row, POINT_P + c] = p[c]
        real[row, POINT_WO + c] = -direction[c]
        real[row, POINT_NG + c] = -direction[c]
        real[row, POINT_NS + c] = -direction[c]
    real[row, POINT_U] = 0.0
    real[row, POINT_V] = 0.0
    # As in Cycles, which has no length for programs of media.
    real[row, POINT_RAY_LENGTH] = 0.0
    real[row, POINT_RADIUS] = paths.radius[lane] + distance * paths.spread[lane]
    real[row, POINT_RANDOM] = 0.0
    real[row, POINT_TIME] = paths.time[lane]
    integer[row, POINT_INSTANCE] = instance
    integer[row, POINT_TRIANGLE] = -1
    integer[row, POINT_PROGRAM] = program
    integer[row, POINT_RAY_FLAGS] = flags
    integer[row, POINT_FLAGS] = 0
    integer[row, POINT_LIGHT] = -1
    store_depths(paths, lane, transparent_depth, points, row)


@kernel
def _to_channels(scene, paths, lane, sums, largest_kind):
    """Coefficients in RGB at the path's channels; extinction, so far absorption, gets the scattering besides."""
    if len(paths.channels) > RGB:
        for kind in range(largest_kind + 1):
            upsample_light(
                scene.spectrum, paths, lane, sums[kind, 0], sums[kind, 1], sums[kind, 2], 0.0, sums, kind
            )
    for c in range(len(paths.channels)):
        sums[EXTINCTION, c] += sums[SCATTERING, c]


@kernel
def read_medium(scene, paths, lane, closures, row, instance, sums):
    """Write into `sums` what a program has left of a medium in row `row` of `closures`, in RGB.

    Parameters
    ----------
    instance : int
        That the medium is inside of, which may make it denser.

    Returns
    -------
    bool
        Whether they were numbers; else all are 0.
    """
    total = 0.0
    density = 1.0
    if instance >= 0:
        density = scene.geometry.instance_values[instance, VALUE_DENSITY]
    for c in range(RGB):
        scattering = 0.0
        for i in range(closures.count[row]):
            scattering += closures.param[row, i, CLOSURE_WEIGHT + c]
        sums[EXTINCTION, c] = density * closures.transparency[row, c]
        sums[SCATTERING, c] = density * scattering
        sums[EMISSION, c] = density * max(closures.emission[row, c], 0.0)
        total += closures.transparency[row, c] + scattering + closures.emission[row, c]
    is_finite = math.isfinite(total)
    if not is_finite:
        for kind in range(EMISSION + 1):
            for c in range(RGB):
                sums[kind, c] = 0.0
    _to_channels(scene, paths, lane, sums, EMISSION)
    return is_finite


@kernel
def read_uniform(scene, paths, lane, medium, sums):
    """Write into `sums` extinction and scattering of a medium that is the same everywhere."""
    media = scene.media.media
    for c in range(RGB):
        sums[EXTINCTION, c] = media[medium, MEDIUM_ABSORPTION + c]
        sums[SCATTERING, c] = media[medium, MEDIUM_SCATTERING + c]
    _to_channels(scene, paths, lane, sums, SCATTERING)


@kernel
def meet_medium(paths, lane, tracking, row, majorant, sums, may_scatter, u_event, u_roulette):
    """Decide what a path does at a possible collision, and update its weight.

    It scatters, or goes on as after a null collision. The probability is the mean over channels, by what light each of
    them has left, of their own: what is left is divided by that, for all channels alike.

    Parameters
    ----------
    majorant : float32 [m^-1]
    sums : float32 (COEFFICIENT_ROWS, C)
        At the path's channels.

    Returns
    -------
    int
        GOES_ON, COLLIDES or ENDS.
    """
    weight = tracking.weight
    scattered, passed = 0.0, 0.0
    for c in range(len(paths.channels)):
        light = abs(paths.throughput[lane, c] * weight[row, c])
        scattered += light * sums[SCATTERING, c]
        passed += light * abs(majorant - sums[EXTINCTION, c])
    if not may_scatter:
        scattered = 0.0
    if not scattered + passed > 0.0:
        for c in range(len(paths.channels)):
            weight[row, c] = 0.0
        return ENDS
    probability = scattered / (scattered + passed)
    if u_event < probability:
        for c in range(len(paths.channels)):
            weight[row, c] *= sums[SCATTERING, c] / (majorant * probability)
        return COLLIDES
    left, whole = 0.0, 0.0
    for c in range(len(paths.channels)):
        weight[row, c] *= (majorant - sums[EXTINCTION, c]) / (majorant * (1.0 - probability))
        left += abs(paths.throughput[lane, c] * weight[row, c])
        whole += abs(paths.throughput[lane, c])
    return GOES_ON if survives(weight, row, len(paths.channels), left, whole, u_roulette) else ENDS


@kernel
def survives(weight, row, channel_count, left, whole, u):
    """Russian roulette for a ray of whose light little is left; its weight is updated.

    Parameters
    ----------
    left, whole : float32
        What there is, of how much.
    """
    if not left < _ROULETTE_BELOW * whole:
        return True
    probability = left / (_ROULETTE_BELOW * whole)
    if not u < probability:
        for c in range(channel_count):
            weight[row, c] = 0.0
        return False
    for c in range(channel_count):
        weight[row, c] /= probability
    return True
