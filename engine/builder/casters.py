# SPDX-License-Identifier: GPL-3.0-or-later
"""Casters: surfaces so sharp that what light does behind them is found by photons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.builder.environment import sampled_whole
from engine.builder.geometry import GeometryCache
from engine.builder.motion import corners_in_motion, world_corners
from engine.scene.content import Kept
from engine.scene.description import VISIBLE_SHADOW
from engine.settings import RenderSettings
from engine.shaders.program_cache import ProgramCache
from engine.state.geometry import (
    INSTANCE_FLAG_CATCHER,
    INSTANCE_FLAG_HOLDOUT,
    INSTANCE_FLAG_MOVING,
    INSTANCE_FLAGS,
    INSTANCE_MATERIAL_OFFSET,
    INSTANCE_MESH,
    INSTANCE_VISIBILITY,
    MESH_FIRST_TRIANGLE,
    MESH_MOTION,
    MESH_SHAPE,
    MESH_TRIANGLE_COUNT,
    SHAPE_TRIANGLES,
    GeometryArrays,
)
from engine.state.lights import LightArrays
from engine.state.photons import MAY_CAST, MAY_GATHER, MOVES, REFRACTS, CasterArrays, no_casters

#: Pieces that casters of few triangles are divided into, about, and how often a triangle is.
_PIECES = 1 << 11
_MOST_LEVELS = 6
#: Groups of small triangles, at least: as few paths as are tried tell no more of each.
_GROUPS = 256
#: Instances, and triangles of each, that say how far things go, at most about.
_FOLLOWED = 256


def build_casters(
    geometry: GeometryArrays, programs: Sequence[bool], refracts: Sequence[bool], lights: LightArrays
) -> CasterArrays:
    """The triangles of all sharp surfaces, by their areas in the world in the middle of the shutter.

    Parameters
    ----------
    geometry : GeometryArrays
    programs : sequence of bool
        By program, whether photons may begin there.
    refracts : sequence of bool
        By program, whether light goes through its surfaces.
    lights : LightArrays

    Returns
    -------
    CasterArrays
        Without triangles where there is no such surface.
    """
    is_sharp, is_refractive = np.array(programs, np.uint8), np.array(refracts, bool)
    table, meshes = geometry.instance_table, geometry.mesh_table
    if not is_sharp.any() or not len(table):
        return no_casters(lights)
    of_mesh = meshes[table[:, INSTANCE_MESH]]
    flags = table[:, INSTANCE_FLAGS]
    moves = (flags & INSTANCE_FLAG_MOVING != 0) | (of_mesh[:, MESH_MOTION] >= 0)
    has_faces = of_mesh[:, MESH_SHAPE] == SHAPE_TRIANGLES
    is_shown = flags & INSTANCE_FLAG_HOLDOUT == 0
    # Places on curves and points are not followed.
    gathers = is_shown & (has_faces | ~moves)
    # What shadow catchers do to light themselves is no effect of objects: casters are none. Through what casts no
    # shadow light samples bring the light already.
    may_cast = is_shown & has_faces & (flags & INSTANCE_FLAG_CATCHER == 0)
    may_cast &= table[:, INSTANCE_VISIBILITY] & VISIBLE_SHADOW != 0
    first_row = np.full(len(table), -1, np.int32)
    rows: list[np.ndarray] = []
    triangles: list[np.ndarray] = []
    areas: list[np.ndarray] = []
    middles: list[np.ndarray] = []
    octants: list[np.ndarray] = []
    through: list[int] = []
    for instance in np.flatnonzero(may_cast):
        mesh = meshes[table[instance, INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        slots = geometry.material_slots[first : first + count]
        material = geometry.instance_materials[table[instance, INSTANCE_MATERIAL_OFFSET] + slots]
        sharp = is_sharp[material] != 0
        if not sharp.any():
            continue
        first_row[instance] = sum(len(row) for row in rows)
        if is_refractive[material].any():
            through.append(int(instance))
        rows.append(np.full(count, instance, np.int32))
        triangles.append(np.arange(first, first + count, dtype=np.int32))
        corners = world_corners(geometry, instance, triangles[-1])
        edges = corners[:, 1:] - corners[:, :1]
        normal = np.cross(edges[:, 0], edges[:, 1])
        area = 0.5 * np.linalg.norm(normal, axis=1)
        areas.append(np.where(sharp & np.isfinite(area), area, 0.0))
        middles.append(corners.mean(axis=1))
        octants.append((normal > 0.0) @ np.array([1, 2, 4]))
    if not rows or not sum(float(area.sum()) for area in areas) > 0.0:
        return no_casters(lights)
    area = np.concatenate(areas)
    level = _levels(area)
    has_pieces = area > 0.0
    pieces = np.where(has_pieces, 4**level, 0)
    first_piece = np.where(has_pieces, np.cumsum(pieces) - pieces, -1)
    row = np.repeat(np.arange(len(area)), pieces)
    casts = np.where(first_row >= 0, MAY_CAST, 0)
    casts[through] |= REFRACTS
    return CasterArrays(
        first_row=first_row, instance=np.concatenate(rows), triangle=np.concatenate(triangles),
        first_piece=first_piece.astype(np.int32), level=level.astype(np.int32), row=row.astype(np.int32),
        group=_groups(np.concatenate(middles)[row], np.concatenate(octants)[row], level[row]),
        area=(area / 4.0**level)[row].astype(np.float32),
        instances=(np.where(gathers, MAY_GATHER, 0) | casts | np.where(moves, MOVES, 0)).astype(np.uint8),
        motion=np.array([_longest_way(geometry, np.flatnonzero(moves))], np.float32), lights=lights,
    )  # fmt: skip


def _levels(area: np.ndarray) -> np.ndarray:
    """How often triangles are divided by four, so that no piece is much of all: int64."""
    least = area.sum() / _PIECES
    with np.errstate(divide="ignore"):
        halvings = np.log2(np.where(area > 0.0, area, least) / least)
    return np.clip(np.ceil(0.5 * halvings), 0, _MOST_LEVELS).astype(np.int64)


def _longest_way(geometry: GeometryArrays, instances: np.ndarray) -> float:
    """How far a corner goes while the shutter is open, of some of the triangles of some instances [m]."""
    longest = 0.0
    for instance in instances[:: max(len(instances) // _FOLLOWED, 1)].tolist():
        mesh = geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        followed = np.arange(first, first + count, max(count // _FOLLOWED, 1))
        ways = np.ptp(np.stack(corners_in_motion(geometry, instance, followed)), axis=0)
        longest = max(longest, float(np.linalg.norm(ways, axis=-1).max(initial=0.0)))
    return longest if np.isfinite(longest) else 0.0


def _groups(middles: np.ndarray, octants: np.ndarray, level: np.ndarray) -> np.ndarray:
    """Numbers of groups of pieces: those of a triangle that was divided are each one, others by place and normal.

    The two faces of a pane lie together, and one of them sees the lamp.

    Parameters
    ----------
    middles : float64 (P, 3)
        Of the pieces' triangles [m].
    octants : int64 (P,)
        Of their normals, below 8.
    level : int64 (P,)
        How often these were divided.
    """
    groups = np.arange(len(middles), dtype=np.int64)
    whole = np.flatnonzero(level == 0)
    if len(whole) > _GROUPS:
        low, extent = middles[whole].min(axis=0), float(np.ptp(middles[whole], axis=0).max())
        cells, found = 1, np.zeros(len(whole), np.int64)
        while cells < 1 << 10 and found.max() < _GROUPS:
            cells *= 2
            place = np.minimum((middles[whole] - low) / max(extent, 1e-30) * cells, cells - 1).astype(np.int64)
            found = np.unique(place @ np.array([1, cells, cells * cells]), return_inverse=True)[1].reshape(-1)
        groups[whole] = len(middles) + 8 * found + octants[whole]
    return np.unique(groups, return_inverse=True)[1].reshape(-1).astype(np.int32)


class KeptCasters:
    """Casters that are at hand while geometry and materials are the same."""

    def __init__(self) -> None:
        self._kept: Kept[CasterArrays] = Kept()

    def get(
        self, meshes: GeometryCache, programs: ProgramCache, geometry: GeometryArrays, lights: LightArrays,
        settings: RenderSettings,
    ) -> CasterArrays:
        """Where photons may begin; nowhere unless the settings ask for some.

        Parameters
        ----------
        meshes, programs
            Of which geometry and materials were made.
        """
        if not settings.traces_photons:
            self._kept.drop()
            return no_casters(lights)
        casts = tuple(program.makes_caustics for program in programs.compiled)
        refracts = tuple(program.refracts or program.lets_through for program in programs.compiled)
        key = meshes.geometry.version, casts, refracts
        casters = self._kept.get(key, lambda: build_casters(geometry, casts, refracts, lights))
        # Scattering finds nothing here that light samples leave to it.
        return casters._replace(lights=sampled_whole(lights))
