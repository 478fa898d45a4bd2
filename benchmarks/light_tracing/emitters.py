# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, glowing meshes and a uniform world as what photons leave: tables, and the kernel that draws a photon.

A sun and the world send photons through a disc that covers the scene's bounding sphere (Jensen 2001, "Realistic Image
Synthesis Using Photon Mapping", section 5.2).
"""

from __future__ import annotations

import math

import numpy as np

from benchmarks.light_tracing.glowing import glowing_triangles
from engine.array_types import Float32Array
from engine.builder.scene import Scene
from engine.kernels.constants import TWO_PI
from engine.kernels.vector import add, orthonormal_basis, scale, to_world
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA, VISIBLE_SHADOW, Light, SceneDescription
from engine.state.shaders import (
    PROGRAM_EMISSION_CONSTANT,
    PROGRAM_FLAGS,
    PROGRAM_HAS_EMISSION,
    VALUE_EMISSION,
)

SUN, POINT, AREA, WORLD, TRIANGLE = range(5)

# Columns of `Emitters.real`.
POWER = 0  # 3: of all its photons [W]
MIDDLE = 3  # 3: of the lamp, or of the scene; a triangle's first corner [m]
SIZE = 6  # radius of the lamp or of the scene, how far photons start off a triangle [m]
AXIS = 7  # 3: unit, in which a sun or an area lamp shines; a triangle's normal
ONE_MINUS_COS = 10  # of half a sun's angle
ALONG_U, ALONG_V = 11, 14  # 3 each: half an area lamp's sides, a triangle's edges [m]
EMITTER_WIDTH = 17
#: How far photons start off a triangle, over its farthest coordinate: rounding is smaller.
_OFF_TRIANGLES = 1e-6

# Columns of `Emitters.integer`.
KIND = 0
#: A point lamp that is a disc which faces what it lights; an area lamp that is an ellipse.
IS_DISC = 1


class Emitters(Bundle):
    """What photons leave.

    real : float32 (N, EMITTER_WIDTH); integer : int32 (N, 2)
    cumulative : float32 (N,), probability of an emitter up to each, by power
    reach : float32 (N,), radius of the sphere about a lamp in which it is seen [m], 0 of suns, meshes and the world
    """

    real: Float32Array
    integer: np.ndarray
    cumulative: Float32Array
    reach: Float32Array


def bounding_sphere(description: SceneDescription) -> tuple[np.ndarray, float]:
    """Middle, float64 (3,), and radius of a sphere around all meshes [m].

    Raises
    ------
    ValueError
        If there are none.
    """
    corners = []
    instances = description.instances
    for mesh, transform in zip(instances.mesh, instances.transform, strict=True):
        vertices = description.meshes[mesh].vertices
        if len(vertices):
            matrix = np.asarray(transform, np.float64)
            placed = vertices @ matrix[:3, :3].T + matrix[:3, 3]
            corners += [placed.min(axis=0), placed.max(axis=0)]
    if not corners:
        raise ValueError("the scene has no mesh that photons could meet")
    low, high = np.min(corners, axis=0), np.max(corners, axis=0)
    return 0.5 * (low + high), 0.5 * float(np.linalg.norm(high - low))


def _refuse(light: Light, has_links: bool) -> None:
    """Raise for what a photon would have to know of the path that it becomes part of."""
    reasons = {
        "is a spot: make it a point": light.kind == "SPOT",
        "has nodes: make its colour plain": light.graph is not None,
        "is not normalised": not light.is_normalized,
        "casts no shadow": not light.cast_shadow,
        "is hidden from some rays": (light.visibility | VISIBLE_CAMERA | VISIBLE_SHADOW) & VISIBLE_ALL != VISIBLE_ALL,
        "has a spread": light.kind == "AREA" and light.spread < math.pi - 1e-4,
        "is linked to some objects only": has_links,
    }
    for reason, holds in reasons.items():
        if holds:
            raise ValueError(f"the lamp {light.name!r} {reason}; photons are traced for plain lamps only")


def _sun(row: np.ndarray, strength: np.ndarray, light: Light, middle: np.ndarray, radius: float) -> None:
    half = 0.5 * light.angle
    row[MIDDLE : MIDDLE + 3], row[SIZE] = middle, radius
    row[ONE_MINUS_COS] = 2.0 * math.sin(0.5 * half) ** 2
    # Radiance times solid angle, through the disc, which faces each direction.
    spread = 2.0 * row[ONE_MINUS_COS] / math.sin(half) ** 2 if half > 0.0 else 1.0
    row[POWER : POWER + 3] = strength * spread * math.pi * radius**2


def _area(row: np.ndarray, light: Light) -> None:
    matrix = np.asarray(light.transform, np.float64)
    size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
    row[ALONG_U : ALONG_U + 3] = 0.5 * light.size_x * matrix[:3, 0]
    row[ALONG_V : ALONG_V + 3] = 0.5 * size_y * matrix[:3, 1]


def _triangles(scene: Scene) -> np.ndarray:
    """Rows of triangles that glow, (T, EMITTER_WIDTH)."""
    corners, radiance = glowing_triangles(scene)
    edges = corners[:, 1:] - corners[:, :1]
    across = np.cross(edges[:, 0], edges[:, 1])
    doubled = np.linalg.norm(across, axis=1, keepdims=True)
    rows = np.zeros((len(corners), EMITTER_WIDTH))
    # Both sides.
    rows[:, POWER : POWER + 3] = radiance * math.pi * doubled
    rows[:, MIDDLE : MIDDLE + 3] = corners[:, 0]
    rows[:, SIZE] = _OFF_TRIANGLES * np.abs(corners).max(axis=(1, 2), initial=0.0)
    rows[:, AXIS : AXIS + 3] = across / doubled
    rows[:, ALONG_U : ALONG_U + 3], rows[:, ALONG_V : ALONG_V + 3] = edges[:, 0], edges[:, 1]
    return rows


def _world_radiance(scene: Scene) -> np.ndarray:
    """Of a uniform world, float64 (3,).

    Raises
    ------
    ValueError
        If it is not uniform.
    """
    world = scene.description.world
    if world is None or scene.world_program < 0:
        return np.zeros(3)
    flags = scene.shaders.programs[scene.world_program, PROGRAM_FLAGS]
    if not flags & PROGRAM_HAS_EMISSION:
        return np.zeros(3)
    if not flags & PROGRAM_EMISSION_CONSTANT:
        raise ValueError(f"the world {world.name!r} is not uniform: give it a plain background")
    values = scene.shaders.program_values[scene.world_program, VALUE_EMISSION : VALUE_EMISSION + 3]
    return np.asarray(values, np.float64)


def make_emitters(scene: Scene) -> Emitters:
    """All emitters of a scene.

    Raises
    ------
    ValueError
        Naming the emitter for which photons are not traced, or if there is none.
    """
    description = scene.description
    middle, radius = bounding_sphere(description)
    rows, kinds = [], []
    for light in description.lights:
        _refuse(light, description.linking is not None)
        row = np.zeros(EMITTER_WIDTH)
        matrix = np.asarray(light.transform, np.float64)
        strength = light.energy * np.asarray(light.color, np.float64)
        row[POWER : POWER + 3] = strength
        row[MIDDLE : MIDDLE + 3], row[SIZE] = matrix[:3, 3], light.radius
        row[AXIS : AXIS + 3] = -matrix[:3, 2] / np.linalg.norm(matrix[:3, 2])
        kind = {"SUN": SUN, "POINT": POINT, "AREA": AREA}[light.kind]
        is_disc = light.use_soft_falloff and light.radius > 0.0
        if kind == SUN:
            _sun(row, strength, light, middle, radius)
        elif kind == AREA:
            _area(row, light)
            is_disc = light.shape in ("DISK", "ELLIPSE")
        rows.append(row)
        kinds.append((kind, int(is_disc)))
    radiance = _world_radiance(scene)
    if radiance.any():
        row = np.zeros(EMITTER_WIDTH)
        row[POWER : POWER + 3] = radiance * 4.0 * math.pi * math.pi * radius**2
        row[MIDDLE : MIDDLE + 3], row[SIZE], row[AXIS + 2] = middle, radius, 1.0
        rows.append(row)
        kinds.append((WORLD, 0))
    triangles = _triangles(scene)
    rows += list(triangles)
    kinds += [(TRIANGLE, 0)] * len(triangles)
    real = np.array(rows).reshape(-1, EMITTER_WIDTH)
    power = real[:, POWER : POWER + 3].mean(axis=1)
    if not power.sum() > 0.0:
        raise ValueError("nothing emits light: add a lamp")
    cumulative = np.cumsum(power) / power.sum()
    cumulative[-1] = 1.0
    integer = np.array(kinds, np.int32)
    across = np.linalg.norm(real[:, ALONG_U : ALONG_V + 3].reshape(-1, 2, 3), axis=2)
    reach = np.where(integer[:, KIND] == POINT, real[:, SIZE], np.hypot(across[:, 0], across[:, 1]))
    reach[integer[:, KIND] == TRIANGLE] = 0.0
    return Emitters(real.astype(np.float32), integer, cumulative.astype(np.float32), reach.astype(np.float32))


@kernel
def _triple(real, row, column):
    return real[row, column], real[row, column + 1], real[row, column + 2]


@kernel
def _on_disc(u, v):
    """Uniform on the unit disc."""
    radius = math.sqrt(u)
    return radius * math.cos(TWO_PI * v), radius * math.sin(TWO_PI * v)


@kernel
def _cosine_direction(axis, u, v):
    x, y = _on_disc(u, v)
    tangent, bitangent = orthonormal_basis(axis)
    return to_world((x, y, math.sqrt(max(1.0 - u, 0.0))), tangent, bitangent, axis)


@kernel
def pick_emitter(emitters, u):
    """Row of the emitter for a uniform number, and the probability of that."""
    row, last = 0, emitters.cumulative.shape[0] - 1
    while row < last:
        middle = (row + last) // 2
        if u < emitters.cumulative[middle]:
            last = middle
        else:
            row = middle + 1
    before = emitters.cumulative[row - 1] if row > 0 else np.float32(0.0)
    return row, emitters.cumulative[row] - before


@kernel
def _through_disc(real, row, direction, u, v):
    """A photon through the disc before the scene that faces `direction`."""
    x, y = _on_disc(u, v)
    size = real[row, SIZE]
    tangent, bitangent = orthonormal_basis(direction)
    offset = to_world((size * x, size * y, -size), tangent, bitangent, direction)
    return add(_triple(real, row, MIDDLE), offset)


@kernel
def _from_triangle(real, row, u):
    """A photon of a triangle, from either side.

    References: Pharr et al. 2016, "Physically Based Rendering", 13.6.5 (uniform on a triangle).
    """
    normal, side = _triple(real, row, AXIS), 2.0 * u[0]
    if side >= 1.0:
        normal, side = scale(normal, -1.0), side - 1.0
    root = math.sqrt(u[2])
    along = add(scale(_triple(real, row, ALONG_U), 1.0 - root), scale(_triple(real, row, ALONG_V), u[3] * root))
    start = add(add(_triple(real, row, MIDDLE), along), scale(normal, real[row, SIZE]))
    return start, _cosine_direction(normal, side, u[1])


@kernel
def emit(emitters, row, u):
    """Draw a photon of an emitter.

    Parameters
    ----------
    u : 4 float32 in [0, 1)

    Returns
    -------
    origin, direction : 3-tuples
    """
    real, kind = emitters.real, emitters.integer[row, KIND]
    middle, axis = _triple(real, row, MIDDLE), _triple(real, row, AXIS)
    if kind == WORLD or kind == SUN:
        # A cap of directions; of the world it is the whole sphere.
        rise = u[0] * (2.0 if kind == WORLD else real[row, ONE_MINUS_COS])
        sine = math.sqrt(max(rise * (2.0 - rise), 0.0))
        tangent, bitangent = orthonormal_basis(axis)
        local = (sine * math.cos(TWO_PI * u[1]), sine * math.sin(TWO_PI * u[1]), 1.0 - rise)
        direction = to_world(local, tangent, bitangent, axis)
        return _through_disc(real, row, direction, u[2], u[3]), direction
    if kind == TRIANGLE:
        return _from_triangle(real, row, u)
    if kind == AREA:
        along_u, along_v = 2.0 * u[2] - 1.0, 2.0 * u[3] - 1.0
        if emitters.integer[row, IS_DISC] != 0:
            along_u, along_v = _on_disc(u[2], u[3])
        offset = add(scale(_triple(real, row, ALONG_U), along_u), scale(_triple(real, row, ALONG_V), along_v))
        return add(middle, offset), _cosine_direction(axis, u[0], u[1])
    height = 1.0 - 2.0 * u[2]
    sine = math.sqrt(max(1.0 - height * height, 0.0))
    normal = (sine * math.cos(TWO_PI * u[3]), sine * math.sin(TWO_PI * u[3]), height)
    return add(middle, scale(normal, real[row, SIZE])), _cosine_direction(normal, u[0], u[1])


@kernel
def is_emitted(emitters, row, origin, direction, p):
    """Whether a point sees the emitter in a photon's direction.

    A point lamp with soft falloff is a disc that faces the point: of the rays that meet the sphere, those that pass the
    middle at less than r d / sqrt(r^2 + d^2), from a distance d, meet that.
    """
    if emitters.integer[row, KIND] != POINT or emitters.integer[row, IS_DISC] == 0:
        return True
    middle, radius = _triple(emitters.real, row, MIDDLE), emitters.real[row, SIZE]
    ax, ay, az = middle[0] - origin[0], middle[1] - origin[1], middle[2] - origin[2]
    along = ax * direction[0] + ay * direction[1] + az * direction[2]
    missed = max(ax * ax + ay * ay + az * az - along * along, 0.0)
    dx, dy, dz = p[0] - middle[0], p[1] - middle[1], p[2] - middle[2]
    squared = dx * dx + dy * dy + dz * dz
    return missed * (radius * radius + squared) <= radius * radius * squared
