# SPDX-License-Identifier: GPL-3.0-or-later
"""Lamps, emissive triangles and the background of a scene, as `LightArrays`.

Blender's units: points, spots and areas in watts, suns in W m^-2, with Cycles' meaning of each shape's radiance:

- point and spot of radius r: power / (4 pi^2 r^2); as a sphere, or with soft falloff as a disc facing the receiver;
- area: power / (pi area), times the spread's own normalisation;
- sun of half angle a: irradiance / (pi sin(a)^2);

where a lamp that is not normalised takes 1 for 4 pi r^2, the area and pi sin(a)^2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from engine.scene import light_arrays as la
from engine.scene import light_tree as lt
from engine.scene.arrays import (
    INSTANCE_FLAG_MIRRORED,
    INSTANCE_FLAGS,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_TRIANGLE_COUNT,
    Float32Array,
    GeometryArrays,
    Int32Array,
)
from engine.scene.description import (
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    VISIBLE_TRANSMISSION,
    VISIBLE_VOLUME,
    Light,
    Notice,
    SceneDescription,
)
from engine.scene.environment import build_environment_map, build_map_guide, empty_map
from engine.scene.light_arrays import LightArrays
from engine.scene.motion import corners_in_motion, is_in_motion, world_corners

#: `ProgramInfo.sampling_mode`: sides sampled, or AUTO (decided by `resolve_sampling`).
SAMPLING_AUTO = -1
SAMPLING_NONE = 0
SAMPLING_FRONT = la.EMITTER_FRONT
SAMPLING_BACK = la.EMITTER_BACK
SAMPLING_FRONT_BACK = la.EMITTER_FRONT | la.EMITTER_BACK
#: By `Material.emission_sampling`.
SAMPLING_MODES = {
    "AUTO": SAMPLING_AUTO,
    "NONE": SAMPLING_NONE,
    "FRONT": SAMPLING_FRONT,
    "BACK": SAMPLING_BACK,
    "FRONT_BACK": SAMPLING_FRONT_BACK,
}

#: Weaker emission than this is left to scattered rays to find, in automatic mode (as Cycles does).
_AUTO_THRESHOLD = 0.5
_VISIBLE_TO_SCATTERING = VISIBLE_DIFFUSE | VISIBLE_GLOSSY | VISIBLE_TRANSMISSION | VISIBLE_VOLUME


@dataclass
class ProgramInfo:
    """What light sampling needs to know about shader programs, P of them (materials, lights, world).

    Attributes
    ----------
    has_emission : bool (P,)
    emission_is_constant : bool (P,)
        Emission is `emission_estimate` wherever and however it is seen.
    emission_estimate : float32 (P, 3)
        Radiance of surfaces, factor on the strength of lights.
    temperature : float32 (P,)
        [K] of those that emit as a black body does, else 0.
    sampling_mode : int (P,)
        SAMPLING_*; only read for materials.
    light_program : int32 (lights,)
        Program of each light's graph, -1 = none.
    world_program : int
        -1 = none.
    """

    has_emission: npt.NDArray[np.bool_]
    emission_is_constant: npt.NDArray[np.bool_]
    emission_estimate: Float32Array
    temperature: Float32Array
    sampling_mode: npt.NDArray[np.int32]
    light_program: Int32Array = field(default_factory=lambda: np.zeros(0, np.int32))
    world_program: int = -1


def resolve_sampling(info: ProgramInfo) -> npt.NDArray[np.int32]:
    """Sides of each program that are sampled as a light (P,), with AUTO decided."""
    mode = np.asarray(info.sampling_mode, np.int32)
    strong = np.abs(info.emission_estimate).max(axis=1, initial=0.0) > _AUTO_THRESHOLD
    mode = np.where(mode == SAMPLING_AUTO, np.where(strong, SAMPLING_FRONT_BACK, SAMPLING_NONE), mode)
    emits = np.asarray(info.has_emission, bool) & (np.abs(info.emission_estimate).max(axis=1, initial=0.0) > 0.0)
    return np.where(emits, mode, SAMPLING_NONE).astype(np.int32)


# ---------------------------------------------------------------------------------------------------------------------
# Emissive triangles


@dataclass
class _Triangles:
    """Emissive triangles found, T of them, and the way back from (instance, triangle)."""

    emitters: Int32Array
    rows: Float32Array
    bounds: Float32Array
    lookup_offset: npt.NDArray[np.int64]
    lookup: Int32Array


def _emissive_instances(geometry: GeometryArrays, sides: Int32Array) -> np.ndarray:
    """Instances that have a material which is sampled as a light, and that scattered rays can see."""
    instances = geometry.instance_table
    if len(instances) == 0 or len(geometry.instance_materials) == 0 or not sides.any():
        return np.zeros(0, np.int64)
    slot_count = np.ones(len(geometry.mesh_table), np.int64)
    for mesh, row in enumerate(geometry.mesh_table):
        first, count = int(row[MESH_FIRST_TRIANGLE]), int(row[MESH_TRIANGLE_COUNT])
        if count:
            slot_count[mesh] = int(geometry.material_slots[first : first + count].max()) + 1
    programs = geometry.instance_materials
    emissive = np.where(programs >= 0, sides[np.maximum(programs, 0)] != 0, False)
    before = np.concatenate([[0], np.cumsum(emissive)])
    starts = np.minimum(instances[:, INSTANCE_MATERIAL_OFFSET].astype(np.int64), len(programs))
    ends = np.minimum(starts + slot_count[instances[:, INSTANCE_MESH]], len(programs))
    visible = (instances[:, INSTANCE_VISIBILITY] & _VISIBLE_TO_SCATTERING) != 0
    return np.flatnonzero((before[ends] > before[starts]) & visible)


def _widen(bound: np.ndarray, shapes: Sequence[np.ndarray], normal: np.ndarray) -> None:
    """Bounds of triangles that move: all places, and all normals where they turn.

    Parameters
    ----------
    bound : float32 (T, BOUNDS_WIDTH), changed
    shapes : sequence of float64 (T, 3, 3)
        Corners at different times.
    normal : float64 (T, 3), at the middle of the shutter, unit
    """
    lower, upper = slice(lt.BOUNDS_LOWER, lt.BOUNDS_LOWER + 3), slice(lt.BOUNDS_UPPER, lt.BOUNDS_UPPER + 3)
    least = np.ones(len(bound))
    for corners in shapes:
        bound[:, lower] = np.minimum(bound[:, lower], corners.min(axis=1))
        bound[:, upper] = np.maximum(bound[:, upper], corners.max(axis=1))
        turned = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.maximum(np.linalg.norm(turned, axis=1), 1e-300)
        least = np.minimum(least, np.einsum("ij,ij->i", turned, normal) / length)
    # Between two keys normals are none of theirs, but hardly farther out.
    angle = np.arccos(np.clip(least, -1.0, 1.0))
    bound[:, lt.BOUNDS_NORMALS] = np.where(angle > 1e-3, np.minimum(1.05 * angle + 0.02, np.pi), 0.0)


def _find_triangles(geometry: GeometryArrays, info: ProgramInfo) -> _Triangles:
    sides = resolve_sampling(info)
    lookup_offset = np.full((max(1, len(geometry.instance_table)), 2), -1, np.int64)
    emitters, rows, bounds, lookup = [], [], [], []
    lookup_count = 0
    triangle_count = 0
    for instance in _emissive_instances(geometry, sides):
        table = geometry.instance_table[instance]
        mesh = geometry.mesh_table[table[INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        slots = geometry.material_slots[first : first + count]
        program = geometry.instance_materials[int(table[INSTANCE_MATERIAL_OFFSET]) + slots]
        found = np.flatnonzero(np.where(program >= 0, sides[np.maximum(program, 0)] != 0, False))
        if len(found) == 0:
            continue
        corners = world_corners(geometry, instance, first + found)
        edge1, edge2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
        normal = np.cross(edge1, edge2)
        doubled = np.linalg.norm(normal, axis=1)
        longest = np.maximum((edge1**2).sum(1), (edge2**2).sum(1))
        good = np.isfinite(doubled) & (doubled > 1e-12 * longest) & (doubled > 1e-30)
        if not good.any():
            continue
        found, corners, edge1, edge2 = found[good], corners[good], edge1[good], edge2[good]
        normal, doubled = normal[good] / doubled[good, None], doubled[good]
        program = program[found]

        flags = sides[program]
        mirrored = bool(table[INSTANCE_FLAGS] & INSTANCE_FLAG_MIRRORED)
        row = np.zeros((len(found), la.EMITTER_WIDTH), np.int32)
        row[:, la.EMITTER_KIND] = la.LIGHT_TRIANGLE
        row[:, la.EMITTER_LAMP] = -1
        row[:, la.EMITTER_INSTANCE] = instance
        row[:, la.EMITTER_TRIANGLE] = first + found
        row[:, la.EMITTER_PROGRAM] = np.where(info.emission_is_constant[program], -1, program)
        in_motion = is_in_motion(geometry, instance)
        row[:, la.EMITTER_FLAGS] = flags | (la.EMITTER_MIRRORED if mirrored else 0)
        row[:, la.EMITTER_FLAGS] |= la.EMITTER_MOVING if in_motion else 0
        row[:, la.EMITTER_VISIBILITY] = table[INSTANCE_VISIBILITY]
        emitters.append(row)

        shape = np.empty((len(found), la.TRIANGLE_WIDTH), np.float32)
        shape[:, la.TRIANGLE_V0 : la.TRIANGLE_V0 + 3] = corners[:, 0]
        shape[:, la.TRIANGLE_EDGE1 : la.TRIANGLE_EDGE1 + 3] = edge1
        shape[:, la.TRIANGLE_EDGE2 : la.TRIANGLE_EDGE2 + 3] = edge2
        shape[:, la.TRIANGLE_RADIANCE :] = np.where(
            info.emission_is_constant[program, None], info.emission_estimate[program], 1.0
        )
        rows.append(shape)

        area = 0.5 * doubled
        outward = np.where((flags == SAMPLING_BACK) != mirrored, -1.0, 1.0)
        bound = np.zeros((len(found), lt.BOUNDS_WIDTH), np.float32)
        bound[:, lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = corners.min(axis=1)
        bound[:, lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = corners.max(axis=1)
        bound[:, lt.BOUNDS_ENERGY] = area * np.abs(info.emission_estimate[program]).mean(axis=1)
        bound[:, lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = normal * outward[:, None]
        bound[:, lt.BOUNDS_EMISSION] = 0.5 * np.pi
        bound[:, lt.BOUNDS_TWO_SIDED] = flags == SAMPLING_FRONT_BACK
        bound[:, lt.BOUNDS_SPREAD] = area / np.pi
        if in_motion:
            _widen(bound, corners_in_motion(geometry, instance, first + found), normal)
        bounds.append(bound)

        lookup_offset[instance] = (lookup_count, first)
        table_row = np.full(count, -1, np.int32)
        table_row[found] = triangle_count + np.arange(len(found))
        lookup.append(table_row)
        lookup_count += count
        triangle_count += len(found)

    def joined(parts: list[np.ndarray], width: int, dtype: type) -> np.ndarray:
        return np.concatenate(parts) if parts else np.zeros((0, width), dtype)

    return _Triangles(
        joined(emitters, la.EMITTER_WIDTH, np.int32),
        joined(rows, la.TRIANGLE_WIDTH, np.float32),
        joined(bounds, lt.BOUNDS_WIDTH, np.float32),
        lookup_offset,
        np.concatenate(lookup) if lookup else np.zeros(0, np.int32),
    )


#: More sources than this are not looked at one by one.
_MAX_SOURCES = 16


def _find_sources(geometry: GeometryArrays, info: ProgramInfo) -> Float32Array | None:
    """Spheres around the emissive triangles of each instance, sampled as lights or not: centre and squared radius.

    None where they are too many, or not finite.
    """
    emits = np.asarray(info.has_emission, bool)
    instances = _emissive_instances(geometry, emits.astype(np.int32))
    if len(instances) > _MAX_SOURCES:
        return None
    spheres = np.zeros((len(instances), 4), np.float64)
    for row, instance in enumerate(instances):
        table = geometry.instance_table[instance]
        mesh = geometry.mesh_table[table[INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        slots = geometry.material_slots[first : first + count]
        program = geometry.instance_materials[int(table[INSTANCE_MATERIAL_OFFSET]) + slots]
        found = np.flatnonzero(np.where(program >= 0, emits[np.maximum(program, 0)], False))
        if len(found) == 0:
            spheres[row, 3] = -1.0
            continue
        shapes = corners_in_motion(geometry, instance, first + found)
        lower = np.min([shape.min(axis=(0, 1)) for shape in shapes], axis=0)
        upper = np.max([shape.max(axis=(0, 1)) for shape in shapes], axis=0)
        center = 0.5 * (lower + upper)
        spheres[row, :3] = center
        spheres[row, 3] = 1.01 * max(((shape - center) ** 2).sum(axis=-1).max() for shape in shapes)
    return spheres[spheres[:, 3] >= 0.0].astype(np.float32) if np.isfinite(spheres).all() else None


# ---------------------------------------------------------------------------------------------------------------------
# Lamps


@dataclass
class _Lamp:
    """One usable lamp: its rows, and what the tree (or the list of distant emitters) needs."""

    values: Float32Array
    table: Int32Array
    bounds: Float32Array
    visibility: int
    #: Suns: cosine and sine of the half angle, irradiance.
    distant: tuple[float, float, float] | None = None

    @property
    def order(self) -> int:
        """Sorting key: those that rays may cross, then deltas, then suns with an angle, then those without."""
        is_delta = bool(self.table[la.LAMP_FLAGS] & la.LAMP_FLAG_DELTA)
        if self.distant is None:
            return int(is_delta)
        return 2 + int(is_delta)


def _unit(vector: np.ndarray) -> np.ndarray:
    norm = float(np.linalg.norm(vector))
    return vector / norm if norm > 0.0 else vector


def _is_grey(color: npt.ArrayLike) -> bool:
    r, g, b = np.asarray(color, np.float64)
    return bool(r == g == b)


def _convert_lamp(light: Light, index: int, program: int, info: ProgramInfo, notices: list[Notice]) -> _Lamp | None:
    """Rows of a lamp, or None where it cannot light anything."""
    strength = np.asarray(light.color, np.float64) * light.energy
    matrix = np.asarray(light.transform, np.float64)
    if not (np.isfinite(strength).all() and np.isfinite(matrix).all()):
        notices.append(Notice(f"light {light.name}", "its transform or strength is NaN or infinite", "it is left out"))
        return None
    flags = (la.LAMP_FLAG_MIS if light.use_mis else 0) | (la.LAMP_FLAG_SHADOW if light.cast_shadow else 0)
    estimate = np.ones(3)
    temperature = light.temperature
    if program >= 0:
        estimate = np.asarray(info.emission_estimate[program], np.float64)
        if info.temperature[program] > 0.0 and _is_grey(light.color):
            temperature = float(info.temperature[program])
        elif not _is_grey(estimate):
            temperature = 0.0
        if info.emission_is_constant[program]:
            strength = strength * estimate
            estimate = np.ones(3)
            program = -1
        else:
            # A ray that crosses the lamp does not run its program: the lamp is left to sampling alone, which does.
            flags &= ~la.LAMP_FLAG_MIS
            notices.append(
                Notice(
                    f"light {light.name}",
                    "its nodes give an emission that varies",
                    "it is sampled exactly, but rays that hit it by chance (mirror reflections) do not see it; to the "
                    "camera it shows its mean",
                )
            )
    if not np.any(strength) or not np.any(estimate):
        return None

    columns = matrix[:3, :3]
    position = matrix[:3, 3]
    direction = _unit(-columns[:, 2])
    values = np.zeros(la.LAMP_WIDTH, np.float64)
    bounds = np.zeros(lt.BOUNDS_WIDTH, np.float64)
    distant = None
    kind = {"POINT": la.LIGHT_POINT, "SPOT": la.LIGHT_SPOT, "AREA": la.LIGHT_AREA, "SUN": la.LIGHT_SUN}.get(light.kind)
    if kind is None:
        raise ValueError(f"light {light.name}: kind is {light.kind!r}, choose POINT, SPOT, AREA or SUN")
    values[la.LAMP_P : la.LAMP_P + 3] = position
    mean = float(np.abs(strength * estimate).mean())

    if kind in (la.LIGHT_POINT, la.LIGHT_SPOT):
        radius = max(0.0, light.radius)
        if not light.use_soft_falloff and radius > 0.0:
            flags |= la.LAMP_FLAG_SPHERE
        if radius > 0.0:
            area = 4.0 * math.pi * radius**2 if light.is_normalized else 1.0
            scale = 1.0 / (math.pi * area)
            intensity = mean * scale * math.pi * radius**2
        else:
            flags = (flags | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS
            scale = 1.0 / (4.0 * math.pi) if light.is_normalized else 1.0 / math.pi
            intensity = mean * scale
        values[la.LAMP_RADIUS] = radius
        bounds[lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - radius
        bounds[lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + radius
        bounds[lt.BOUNDS_ENERGY] = intensity
        bounds[lt.BOUNDS_AXIS + 2] = 1.0
        bounds[lt.BOUNDS_NORMALS] = math.pi
        bounds[lt.BOUNDS_EMISSION] = 0.5 * math.pi
        bounds[lt.BOUNDS_SPREAD] = 0.5 * radius**2
        bounds[lt.BOUNDS_RADIUS_SQUARED] = radius**2
        if kind == la.LIGHT_SPOT:
            half = 0.5 * light.spot_angle
            cosine = math.cos(half)
            lengths = np.linalg.norm(columns, axis=0)
            determinant = float(np.linalg.det(columns))
            if abs(determinant) < 1e-30:
                return None
            values[la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = direction
            values[la.LAMP_INVERSE : la.LAMP_INVERSE + 9] = np.linalg.inv(columns).ravel()
            values[la.LAMP_COS_SPOT] = cosine
            smooth = (1.0 - cosine) * light.spot_blend
            values[la.LAMP_SPOT_SCALE] = min(1e30, 1.0 / max(smooth, 1e-30))
            widest = math.tan(min(half, 0.5 * math.pi - 1e-4)) * max(lengths[0], lengths[1]) / lengths[2]
            values[la.LAMP_ONE_MINUS_COS] = 1.0 - 1.0 / math.sqrt(1.0 + widest**2)
            # Full strength within the inner cone, fading to the outer one.
            inner = math.acos(min(1.0, cosine + smooth))
            narrowest = math.tan(min(inner, 0.5 * math.pi - 1e-4)) * min(lengths[0], lengths[1]) / lengths[2]
            bounds[lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = direction
            bounds[lt.BOUNDS_NORMALS] = math.atan(narrowest)
            bounds[lt.BOUNDS_EMISSION] = math.atan(widest) - math.atan(narrowest) + 2e-3
    elif kind == la.LIGHT_AREA:
        size_x, size_y = light.size_x, light.size_y
        if light.shape in ("SQUARE", "DISK"):
            size_y = size_x
        is_ellipse = light.shape in ("DISK", "ELLIPSE")
        along_u, along_v = columns[:, 0] * size_x, columns[:, 1] * size_y
        length_u, length_v = float(np.linalg.norm(along_u)), float(np.linalg.norm(along_v))
        area = length_u * length_v * (0.25 * math.pi if is_ellipse else 1.0)
        if not area > 0.0:
            return None
        flags |= la.LAMP_FLAG_ELLIPSE if is_ellipse else 0
        spread = min(math.pi, max(0.0, light.spread))
        scale = 1.0 / math.pi / (area if light.is_normalized else 1.0)
        peak = 1.0
        half = 0.5 * spread
        if spread <= 0.0:
            # Parallel light: the radiance's integral over directions is what counts.
            flags = (flags | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS
            scale *= math.pi
            peak = 1e4
        elif spread < math.pi - 1e-6:
            values[la.LAMP_TAN_SPREAD] = math.tan(half)
            values[la.LAMP_SPREAD_SCALE] = 1.0 / (math.tan(half) - half) if half > 0.05 else 3.0 / half**3
            peak = values[la.LAMP_TAN_SPREAD] * values[la.LAMP_SPREAD_SCALE]
        # A sheared lamp is made rectangular again: its normal is its plane's, on the side of its own -z.
        axis_u = along_u / length_u
        axis_v = _unit(along_v - (along_v @ axis_u) * axis_u)
        normal = np.cross(axis_u, axis_v)
        direction = normal if normal @ direction >= 0.0 else -normal
        along_v = axis_v * length_v
        values[la.LAMP_AXIS_U : la.LAMP_AXIS_U + 3] = axis_u
        values[la.LAMP_AXIS_V : la.LAMP_AXIS_V + 3] = axis_v
        values[la.LAMP_DIRECTION : la.LAMP_DIRECTION + 3] = direction
        values[la.LAMP_LENGTH_U], values[la.LAMP_LENGTH_V] = length_u, length_v
        extent = 0.5 * (np.abs(along_u) + np.abs(along_v))
        bounds[lt.BOUNDS_LOWER : lt.BOUNDS_LOWER + 3] = position - extent
        bounds[lt.BOUNDS_UPPER : lt.BOUNDS_UPPER + 3] = position + extent
        radiance = mean * (scale / math.pi if spread <= 0.0 else scale)
        bounds[lt.BOUNDS_ENERGY] = radiance * area * peak
        bounds[lt.BOUNDS_AXIS : lt.BOUNDS_AXIS + 3] = direction
        bounds[lt.BOUNDS_EMISSION] = half + 1e-3
        bounds[lt.BOUNDS_SPREAD] = area * peak / math.pi
        bounds[lt.BOUNDS_RADIUS_SQUARED] = 0.25 * (
            max(length_u, length_v) ** 2 if is_ellipse else length_u**2 + length_v**2
        )
    else:
        half = 0.5 * min(math.pi, max(0.0, light.angle))
        values[la.LAMP_P : la.LAMP_P + 3] = -direction
        disc = math.pi * math.sin(half) ** 2
        values[la.LAMP_ONE_MINUS_COS] = 2.0 * math.sin(0.5 * half) ** 2
        if half > 0.0:
            scale = 1.0 / disc if light.is_normalized else 1.0
            irradiance = mean * scale * disc
        else:
            flags = (flags | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS
            scale = 1.0
            irradiance = mean
        distant = (math.cos(half), math.sin(half), irradiance)

    values[la.LAMP_RADIANCE : la.LAMP_RADIANCE + 3] = strength * scale
    values[la.LAMP_ESTIMATE : la.LAMP_ESTIMATE + 3] = estimate
    values[la.LAMP_TEMPERATURE] = temperature
    table = np.zeros(la.LAMP_TABLE_WIDTH, np.int32)
    table[la.LAMP_KIND] = kind
    table[la.LAMP_FLAGS] = flags
    table[la.LAMP_VISIBILITY] = light.visibility
    table[la.LAMP_MAX_BOUNCES] = min(light.max_bounces, 1 << 20)
    table[la.LAMP_PROGRAM] = program
    table[la.LAMP_LIGHT] = index
    return _Lamp(values.astype(np.float32), table, bounds.astype(np.float32), light.visibility, distant)


def _convert_lamps(lights: list[Light], info: ProgramInfo, notices: list[Notice]) -> list[_Lamp]:
    lamps = []
    for index, light in enumerate(lights):
        program = int(info.light_program[index]) if index < len(info.light_program) else -1
        lamp = _convert_lamp(light, index, program, info, notices)
        if lamp is not None:
            lamps.append(lamp)
    return sorted(lamps, key=lambda lamp: lamp.order)


# ---------------------------------------------------------------------------------------------------------------------


def build_lights(
    description: SceneDescription,
    geometry: GeometryArrays,
    program_info: ProgramInfo,
    background: Float32Array | None = None,
    notices: list[Notice] | None = None,
) -> LightArrays:
    """Everything that emits, ready to be sampled.

    Parameters
    ----------
    description : SceneDescription
        Lights and world are read.
    geometry : GeometryArrays
    program_info : ProgramInfo
    background : float32 (H, W, 3) or None
        The world's radiance on a grid of directions (see `build_environment_map`). None: the background is not sampled
        as a light, scattered rays find it; right for worlds of one colour and for `World.sampling` 'NONE'.
    notices : list of Notice, appended to
    """
    notices = [] if notices is None else notices
    triangles = _find_triangles(geometry, program_info)
    lamps = _convert_lamps(description.lights, program_info, notices)
    marginal, conditional, mean_radiance = (*empty_map(), 0.0)
    world = description.world
    if background is not None and world is not None:
        marginal, conditional, mean_radiance = build_environment_map(background)

    triangle_count = len(triangles.rows)
    local_lamps = [lamp for lamp in lamps if lamp.distant is None]
    suns = lamps[len(local_lamps) :]
    has_background = mean_radiance > 0.0
    emitters = np.zeros((triangle_count + len(lamps) + has_background, la.EMITTER_WIDTH), np.int32)
    emitters[:triangle_count] = triangles.emitters
    for row, lamp in enumerate(lamps):
        lamp.table[la.LAMP_EMITTER] = triangle_count + row
        emitters[triangle_count + row] = (
            lamp.table[la.LAMP_KIND], row, -1, -1, lamp.table[la.LAMP_PROGRAM], 0, 0, lamp.visibility
        )  # fmt: skip

    bounds = np.concatenate([triangles.bounds, *(lamp.bounds[None] for lamp in local_lamps)])
    nodes, links, leaf = lt.build_tree(np.ascontiguousarray(bounds, np.float32))
    emitters[: len(leaf), la.EMITTER_NODE] = leaf

    distant = np.zeros((len(suns) + has_background, la.DISTANT_WIDTH), np.float32)
    for k, sun in enumerate(suns):
        emitter = triangle_count + len(local_lamps) + k
        emitters[emitter, la.EMITTER_NODE] = ~k
        assert sun.distant is not None
        cosine, sine, irradiance = sun.distant
        distant[k, :3] = sun.values[la.LAMP_P : la.LAMP_P + 3]
        distant[k, 3:7] = (cosine, sine, irradiance, emitter)
    if has_background:
        assert world is not None
        emitters[-1] = (
            la.LIGHT_BACKGROUND, -1, -1, -1, program_info.world_program, 0, ~len(suns), world.visibility
        )  # fmt: skip
        distant[-1] = (0.0, 0.0, 1.0, -1.0, 0.0, math.pi * mean_radiance, len(emitters) - 1, 0.0)

    order = np.array([lamp.order for lamp in lamps], np.int64)
    header = np.zeros(la.HEADER_WIDTH, np.int32)
    header[la.HEADER_EMITTERS] = len(emitters)
    header[la.HEADER_HITTABLE] = int((order == 0).sum())
    header[la.HEADER_FIRST_SUN] = len(local_lamps)
    header[la.HEADER_LAST_SUN] = len(local_lamps) + int((order == 2).sum())
    header[la.HEADER_BACKGROUND_EMITTER] = len(emitters) - 1 if has_background else -1
    header[la.HEADER_BACKGROUND_PROGRAM] = program_info.world_program
    header[la.HEADER_BACKGROUND_VISIBILITY] = world.visibility if world else 0
    header[la.HEADER_BACKGROUND_MAX_BOUNCES] = min(world.max_bounces, 1 << 20) if world else 0
    header[la.HEADER_BACKGROUND_SHADOW] = world.cast_shadow if world else 1
    sources = None
    world_program = program_info.world_program
    world_is_black = world_program < 0 or (
        bool(program_info.emission_is_constant[world_program])
        and not np.any(program_info.emission_estimate[world_program])
    )
    # Lamps that rays may cross, suns that they may reach.
    if world_is_black and not np.any((order == 0) | (order == 2)):
        sources = _find_sources(geometry, program_info)
    header[la.HEADER_SOURCES] = -1 if sources is None else len(sources)
    return LightArrays(
        header=header,
        nodes=nodes,
        links=links,
        distant=distant,
        emitters=emitters,
        triangles=triangles.rows,
        sources=sources if sources is not None else np.zeros((0, 4), np.float32),
        lamps=np.array([lamp.values for lamp in lamps], np.float32).reshape(-1, la.LAMP_WIDTH),
        lamp_table=np.array([lamp.table for lamp in lamps], np.int32).reshape(-1, la.LAMP_TABLE_WIDTH),
        lookup_offset=triangles.lookup_offset,
        lookup=triangles.lookup,
        map_marginal=marginal,
        map_conditional=conditional,
        map_guide=build_map_guide(marginal, conditional),
    )
