# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's Voronoi texture in 1 to 4 dimensions.

One function per search (closest points, edges, spheres) for all dimensions and metrics: unused axes have a search
radius of zero and coordinates of zero. The 1D texture (Blender's W) lives on the first axis.
"""

import math
from typing import NamedTuple

import numpy as np

from engine.kernels.limits import clamp, clamp_unit
from engine.kernels.rounding import floor_of
from engine.kernels.shader.procedural_hash import pcg_2, pcg_3, pcg_4, unit_1, unit_2
from engine.runtime.jit import kernel

VORONOI_EUCLIDEAN = 0
VORONOI_MANHATTAN = 1
VORONOI_CHEBYCHEV = 2
VORONOI_MINKOWSKI = 3

VORONOI_F1 = 0
VORONOI_F2 = 1
VORONOI_SMOOTH_F1 = 2
VORONOI_DISTANCE_TO_EDGE = 3
VORONOI_N_SPHERE_RADIUS = 4

_FAR = np.float32(3.4028235e38)


class Voronoi(NamedTuple):
    """Settings of the node: float32, and numbers of VORONOI_* for ints; 1 to 4 dimensions.

    Attributes
    ----------
    smoothness : float32
        As in Blender's socket; `voronoi_texture` halves and clamps it.
    normalize : int
        Not 0: distances are over the furthest there can be.
    """

    dimensions: int
    feature: int
    metric: int
    scale: float
    detail: float
    roughness: float
    lacunarity: float
    smoothness: float
    exponent: float
    randomness: float
    normalize: int


class _Cells(NamedTuple):
    """What one octave goes by: settings as they are clamped."""

    dimensions: int
    feature: int
    metric: int
    exponent: float
    smoothness: float
    randomness: float


@kernel
def _point_in_cell(x, y, z, w, dimensions, randomness):
    """The feature point of an integer cell, relative to the cell's corner."""
    if dimensions == 3:
        a, b, c = pcg_3(x, y, z)
        return a * randomness, b * randomness, c * randomness, 0.0
    if dimensions == 2:
        a, b = pcg_2(x, y)
        return a * randomness, b * randomness, 0.0, 0.0
    if dimensions == 1:
        return unit_1(np.float32(x)) * randomness, 0.0, 0.0, 0.0
    a, b, c, d = pcg_4(x, y, z, w)
    return a * randomness, b * randomness, c * randomness, d * randomness


@kernel
def _color_of_cell(x, y, z, w, dimensions):
    if dimensions == 1:
        position = np.float32(x)
        return unit_1(position), unit_2(position, 1.0), unit_2(position, 2.0)
    if dimensions == 4:
        a, b, c, _d = pcg_4(x, y, z, w)
        return a, b, c
    return pcg_3(x, y, z)  # the 2D texture has z = 0


@kernel
def _measure(x, y, z, w, metric, exponent):
    """A number that grows with the length of (x, y, z, w) in `metric`; `_length` makes it the length."""
    if metric == VORONOI_EUCLIDEAN:
        return x * x + y * y + z * z + w * w
    x, y, z, w = abs(x), abs(y), abs(z), abs(w)
    if metric == VORONOI_MANHATTAN:
        return x + y + z + w
    if metric == VORONOI_CHEBYCHEV:
        return max(max(x, y), max(z, w))
    return math.pow(x, exponent) + math.pow(y, exponent) + math.pow(z, exponent) + math.pow(w, exponent)


@kernel
def _length(measure, metric, exponent):
    if metric == VORONOI_EUCLIDEAN:
        return math.sqrt(measure)
    if metric == VORONOI_MINKOWSKI:
        return math.pow(measure, 1.0 / exponent)
    return measure


@kernel
def _closest(x, y, z, w, cells):
    """One octave of F1, F2 or smooth F1: distance, colour (3) and position (4) of the feature point.

    References: Quilez 2013, "Smooth Voronoi".
    """
    dimensions, feature, metric, exponent, smoothness, randomness = cells
    base_x, base_y, base_z, base_w = floor_of(x), floor_of(y), floor_of(z), floor_of(w)
    lx = x - np.float32(base_x)
    ly = y - np.float32(base_y)
    lz = z - np.float32(base_z)
    lw = w - np.float32(base_w)
    radius = 2 if feature == VORONOI_SMOOTH_F1 else 1
    radius_y = radius if dimensions > 1 else 0
    radius_z = radius if dimensions > 2 else 0
    radius_w = radius if dimensions > 3 else 0

    first = _FAR  # F1, as `_measure`
    distance = _FAR  # the wanted one, as `_measure`; smooth: a length
    fx, fy, fz, fw = 0.0, 0.0, 0.0, 0.0
    px, py, pz, pw = 0.0, 0.0, 0.0, 0.0
    fi, fj, fk, fm = 0, 0, 0, 0
    ci, cj, ck, cm = 0, 0, 0, 0
    red, green, blue = 0.0, 0.0, 0.0
    if feature == VORONOI_SMOOTH_F1:
        distance = 0.0
    is_first = True

    for m in range(-radius_w, radius_w + 1):
        for k in range(-radius_z, radius_z + 1):
            for j in range(-radius_y, radius_y + 1):
                for i in range(-radius, radius + 1):
                    ax, ay, az, aw = _point_in_cell(
                        np.int32(base_x + i), np.int32(base_y + j), np.int32(base_z + k), np.int32(base_w + m),
                        dimensions, randomness,
                    )  # fmt: skip
                    ax += np.float32(i)
                    ay += np.float32(j)
                    az += np.float32(k)
                    aw += np.float32(m)
                    measure = _measure(ax - lx, ay - ly, az - lz, aw - lw, metric, exponent)
                    if feature == VORONOI_SMOOTH_F1:
                        length = _length(measure, metric, exponent)
                        h = 1.0
                        if not is_first:
                            t = min(max(0.5 + 0.5 * (distance - length) / smoothness, 0.0), 1.0)
                            h = (3.0 - 2.0 * t) * (t * t)
                        is_first = False
                        correction = smoothness * h * (1.0 - h)
                        distance += h * (length - distance) - correction
                        correction /= 1.0 + 3.0 * smoothness
                        r, g, b = _color_of_cell(
                            np.int32(base_x + i), np.int32(base_y + j), np.int32(base_z + k), np.int32(base_w + m),
                            dimensions,
                        )  # fmt: skip
                        red += h * (r - red) - correction
                        green += h * (g - green) - correction
                        blue += h * (b - blue) - correction
                        px += h * (ax - px) - correction
                        py += h * (ay - py) - correction
                        pz += h * (az - pz) - correction
                        pw += h * (aw - pw) - correction
                    elif measure < first:
                        if feature == VORONOI_F1:
                            distance = measure
                            px, py, pz, pw = ax, ay, az, aw
                            ci, cj, ck, cm = i, j, k, m
                        else:
                            distance = first
                            px, py, pz, pw = fx, fy, fz, fw
                            ci, cj, ck, cm = fi, fj, fk, fm
                        first = measure
                        fx, fy, fz, fw = ax, ay, az, aw
                        fi, fj, fk, fm = i, j, k, m
                    elif feature == VORONOI_F2 and measure < distance:
                        distance = measure
                        px, py, pz, pw = ax, ay, az, aw
                        ci, cj, ck, cm = i, j, k, m

    if feature != VORONOI_SMOOTH_F1:
        distance = _length(distance, metric, exponent)
        red, green, blue = _color_of_cell(
            np.int32(base_x + ci), np.int32(base_y + cj), np.int32(base_z + ck), np.int32(base_w + cm), dimensions
        )
    px += np.float32(base_x)
    if dimensions > 1:
        py += np.float32(base_y)
    else:
        py = 0.0
    if dimensions > 2:
        pz += np.float32(base_z)
    else:
        pz = 0.0
    if dimensions > 3:
        pw += np.float32(base_w)
    else:
        pw = 0.0
    return distance, red, green, blue, px, py, pz, pw


@kernel
def _edge_or_radius(x, y, z, w, cells):
    """Distance to the closest edge of the diagram, or the radius of the sphere inscribed around the closest point.

    References: Quilez 2012, "Voronoi edges".
    """
    dimensions, feature, randomness = cells.dimensions, cells.feature, cells.randomness
    base_x, base_y, base_z, base_w = floor_of(x), floor_of(y), floor_of(z), floor_of(w)
    lx = x - np.float32(base_x)
    ly = y - np.float32(base_y)
    lz = z - np.float32(base_z)
    lw = w - np.float32(base_w)
    radius_y = 1 if dimensions > 1 else 0
    radius_z = 1 if dimensions > 2 else 0
    radius_w = 1 if dimensions > 3 else 0
    is_edge = feature == VORONOI_DISTANCE_TO_EDGE

    closest = _FAR  # squared distance to the closest point, vector to it from here, its cell
    cx, cy, cz, cw = 0.0, 0.0, 0.0, 0.0
    ci, cj, ck, cm = 0, 0, 0, 0
    result = _FAR
    for step in range(2):
        is_second = step == 1
        # The sphere's second search is around the closest point's cell, the edge's around the point's own.
        oi, oj, ok, om = 0, 0, 0, 0
        if is_second and not is_edge:
            oi, oj, ok, om = ci, cj, ck, cm
        for m in range(om - radius_w, om + radius_w + 1):
            for k in range(ok - radius_z, ok + radius_z + 1):
                for j in range(oj - radius_y, oj + radius_y + 1):
                    for i in range(oi - 1, oi + 2):
                        ax, ay, az, aw = _point_in_cell(
                            np.int32(base_x + i), np.int32(base_y + j), np.int32(base_z + k), np.int32(base_w + m),
                            dimensions, randomness,
                        )  # fmt: skip
                        ax += np.float32(i) - lx
                        ay += np.float32(j) - ly
                        az += np.float32(k) - lz
                        aw += np.float32(m) - lw
                        if not is_second:
                            squared = ax * ax + ay * ay + az * az + aw * aw
                            if squared < closest:
                                closest = squared
                                cx, cy, cz, cw = ax, ay, az, aw
                                ci, cj, ck, cm = i, j, k, m
                            continue
                        ex, ey, ez, ew = ax - cx, ay - cy, az - cz, aw - cw
                        squared = ex * ex + ey * ey + ez * ez + ew * ew
                        if is_edge:
                            if squared > 0.0001:
                                along = (ax + cx) * ex + (ay + cy) * ey + (az + cz) * ez + (aw + cw) * ew
                                result = min(result, 0.5 * along / math.sqrt(squared))
                        elif not (i == oi and j == oj and k == ok and m == om):
                            result = min(result, squared)
    return result if is_edge else 0.5 * math.sqrt(result)


@kernel
def voronoi_texture(x, y, z, w, voronoi):
    """Blender's Voronoi texture at an unscaled position (1D: in `x`, Blender's W).

    Parameters
    ----------
    voronoi : Voronoi

    Returns
    -------
    8 float32
        Distance (or radius), colour (3), position (4, in unscaled coordinates; 1D: in the first).
    """
    dimensions, feature, metric = voronoi.dimensions, voronoi.feature, voronoi.metric
    scale, exponent = voronoi.scale, voronoi.exponent
    x, y, z, w = x * scale, y * scale, z * scale, w * scale
    detail = clamp(voronoi.detail, 0.0, 15.0)
    roughness = clamp_unit(voronoi.roughness)
    randomness = clamp_unit(voronoi.randomness)
    smoothness = clamp(0.5 * voronoi.smoothness, 0.0, 0.5)
    if dimensions == 1:
        metric = VORONOI_EUCLIDEAN
    if feature == VORONOI_SMOOTH_F1 and smoothness == 0.0:
        feature = VORONOI_F1
    cells = _Cells(dimensions, feature, metric, exponent, smoothness, randomness)
    if feature == VORONOI_N_SPHERE_RADIUS:
        radius = _edge_or_radius(x, y, z, w, cells)
        return radius, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0

    is_edge = feature == VORONOI_DISTANCE_TO_EDGE
    reach = 0.5 + 0.5 * randomness
    furthest = reach
    if not is_edge:
        ry = reach if dimensions > 1 else 0.0
        rz = reach if dimensions > 2 else 0.0
        rw = reach if dimensions > 3 else 0.0
        furthest = _length(_measure(reach, ry, rz, rw, metric, exponent), metric, exponent)
        if feature == VORONOI_F2:
            furthest *= 2.0

    distance = 8.0 if is_edge else 0.0
    amplitude_sum = furthest if is_edge else 0.0
    red, green, blue = 0.0, 0.0, 0.0
    px, py, pz, pw = 0.0, 0.0, 0.0, 0.0
    octave_scale = 1.0
    amplitude = 1.0
    whole = floor_of(detail)
    remainder = detail - np.float32(whole)
    is_single = detail == 0.0 or roughness == 0.0
    last = 0 if is_single else int(math.ceil(detail))
    for octave in range(last + 1):
        qx, qy, qz, qw = x * octave_scale, y * octave_scale, z * octave_scale, w * octave_scale
        part = 1.0 if octave <= whole else remainder
        if is_edge:
            edge = _edge_or_radius(qx, qy, qz, qw, cells)
            if is_single:
                distance = edge
                break
            # Here a remainder only shortens the distance, hence the second minimum.
            target = distance + amplitude * (min(distance, edge / octave_scale) - distance)
            sum_target = amplitude_sum + amplitude * (furthest / octave_scale - amplitude_sum)
            if octave <= whole:
                distance = target
                amplitude_sum = sum_target
            else:
                distance += part * (min(distance, target) - distance)
                amplitude_sum += part * (sum_target - amplitude_sum)
        else:
            d, r, g, b, ax, ay, az, aw = _closest(qx, qy, qz, qw, cells)
            if is_single:
                amplitude_sum = 1.0
                distance = d
                red, green, blue = r, g, b
                px, py, pz, pw = ax, ay, az, aw
                break
            share = part * amplitude
            amplitude_sum += share
            distance += share * d
            red += share * r
            green += share * g
            blue += share * b
            px += share * (ax / octave_scale - px)
            py += share * (ay / octave_scale - py)
            pz += share * (az / octave_scale - pz)
            pw += share * (aw / octave_scale - pw)
        octave_scale *= voronoi.lacunarity
        amplitude *= roughness

    if voronoi.normalize:
        distance /= amplitude_sum if is_edge else amplitude_sum * furthest
        if not is_edge:
            red /= amplitude_sum
            green /= amplitude_sum
            blue /= amplitude_sum
    inverse_scale = 1.0 / scale if scale != 0.0 else 0.0
    return (
        distance, red, green, blue,
        px * inverse_scale, py * inverse_scale, pz * inverse_scale, pw * inverse_scale,
    )  # fmt: skip
