# SPDX-License-Identifier: GPL-3.0-or-later
"""How often a path has scattered, by kind: where its depths start, are counted, meet their limits and reach shaders."""

from engine.runtime.jit import kernel
from engine.state.lanes import (
    POINT_DIFFUSE_DEPTH,
    POINT_GLOSSY_DEPTH,
    POINT_PATH_DEPTH,
    POINT_TRANSMISSION_DEPTH,
    POINT_TRANSPARENT_DEPTH,
    RAY_DIFFUSE,
    RAY_REFLECT,
)


@kernel
def reset_depths(paths, lane):
    """A path that has met nothing yet."""
    paths.depth[lane] = 0
    paths.diffuse_depth[lane] = 0
    paths.glossy_depth[lane] = 0
    paths.transmission_depth[lane] = 0
    paths.transparent_depth[lane] = 0


@kernel
def count_scattering(options, paths, lane, label):
    """Count a scattering; returns whether a limit has been reached.

    Parameters
    ----------
    label : int, RAY_* bits as `sample_bsdf` returns them
    """
    depth = paths.depth[lane] + 1
    paths.depth[lane] = depth
    ends = depth >= options.max_depth
    if not label & RAY_REFLECT:
        paths.transmission_depth[lane] += 1
        ends |= paths.transmission_depth[lane] >= options.max_transmission_depth
    elif label & RAY_DIFFUSE:
        paths.diffuse_depth[lane] += 1
        ends |= paths.diffuse_depth[lane] >= options.max_diffuse_depth
    else:
        paths.glossy_depth[lane] += 1
        ends |= paths.glossy_depth[lane] >= options.max_glossy_depth
    return ends


@kernel
def count_collision(options, paths, media, lane):
    """Count a scattering within a medium; returns whether a limit has been reached.

    Parameters
    ----------
    media : MediaLanes
    """
    paths.depth[lane] += 1
    media.depth[lane] += 1
    return paths.depth[lane] >= options.max_depth or media.depth[lane] >= options.max_volume_depth


@kernel
def count_transparent(options, paths, lane):
    """Count a transparent surface that the ray passes through; returns whether the limit has been reached."""
    paths.transparent_depth[lane] += 1
    return paths.transparent_depth[lane] >= options.max_transparent_depth


@kernel
def store_depths(paths, lane, transparent_depth, points, row):
    """Tell shaders at a point how deep the path is.

    Parameters
    ----------
    transparent_depth : int
        The path's own, or that of its shadow ray.
    points : ShadePoints
    row : int
        Row of `points`.
    """
    integer = points.integer
    integer[row, POINT_PATH_DEPTH] = paths.depth[lane]
    integer[row, POINT_DIFFUSE_DEPTH] = paths.diffuse_depth[lane]
    integer[row, POINT_GLOSSY_DEPTH] = paths.glossy_depth[lane]
    integer[row, POINT_TRANSMISSION_DEPTH] = paths.transmission_depth[lane]
    integer[row, POINT_TRANSPARENT_DEPTH] = transparent_depth
