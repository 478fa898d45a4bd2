# SPDX-License-Identifier: GPL-3.0-or-later
"""Casters: surfaces so smooth that what light does behind them is found by photons."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.builder.environment import empty_map
from engine.shaders.compiled_program import CompiledProgram
from engine.state.geometry import (
    INSTANCE_FLAG_BAKED,
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
from engine.state.photons import MAY_CAST, MAY_GATHER, CasterArrays, no_casters


def build_casters(
    geometry: GeometryArrays, programs: Sequence[CompiledProgram], lights: LightArrays
) -> CasterArrays:
    """The triangles of all smooth surfaces that stand still, by their areas in the world.

    Parameters
    ----------
    geometry : GeometryArrays
    programs : sequence of CompiledProgram
        By program; `is_smooth` says which have delta lobes.
    lights : LightArrays

    Returns
    -------
    CasterArrays
        Without triangles where there is no such surface.
    """
    is_smooth = np.array([program.is_smooth for program in programs], np.uint8)
    table, meshes = geometry.instance_table, geometry.mesh_table
    if not is_smooth.any() or not len(table):
        return no_casters(lights)
    of_mesh = meshes[table[:, INSTANCE_MESH]]
    flags = table[:, INSTANCE_FLAGS]
    stands = (flags & INSTANCE_FLAG_MOVING == 0) & (of_mesh[:, MESH_MOTION] < 0)
    stands &= flags & (INSTANCE_FLAG_CATCHER | INSTANCE_FLAG_HOLDOUT) == 0
    has_faces = stands & (of_mesh[:, MESH_SHAPE] == SHAPE_TRIANGLES)
    instances = np.where(stands, MAY_GATHER, 0) | np.where(has_faces, MAY_CAST, 0)
    rows, triangles, areas = [], [], []
    for instance in np.flatnonzero(has_faces & (table[:, INSTANCE_VISIBILITY] != 0)):
        mesh = meshes[table[instance, INSTANCE_MESH]]
        first, count = int(mesh[MESH_FIRST_TRIANGLE]), int(mesh[MESH_TRIANGLE_COUNT])
        slots = geometry.material_slots[first : first + count]
        material = geometry.instance_materials[table[instance, INSTANCE_MATERIAL_OFFSET] + slots]
        chosen = first + np.flatnonzero(is_smooth[material])
        if len(chosen):
            rows.append(np.full(len(chosen), instance, np.int32))
            triangles.append(chosen.astype(np.int32))
            areas.append(_areas(geometry, instance, chosen))
    if not rows:
        return no_casters(lights)
    area = np.concatenate(areas)
    has_area = area > 0.0
    area = area[has_area]
    if not len(area):
        return no_casters(lights)
    cumulative = np.cumsum(area)
    total = float(cumulative[-1])
    cumulative /= total
    cumulative[-1] = 1.0
    return CasterArrays(
        instance=np.concatenate(rows)[has_area], triangle=np.concatenate(triangles)[has_area], cumulative=cumulative,
        area=np.array([total], np.float32), instances=instances.astype(np.uint8), programs=is_smooth,
        lights=_by_the_tree(lights),
    )  # fmt: skip


def _areas(geometry: GeometryArrays, instance: int, triangles: np.ndarray) -> np.ndarray:
    """Areas of an instance's triangles in the world [m^2]: float64."""
    corners = geometry.vertices[geometry.triangles[triangles]].astype(np.float64)
    edges = corners[:, 1:] - corners[:, :1]
    if not geometry.instance_table[instance, INSTANCE_FLAGS] & INSTANCE_FLAG_BAKED:
        edges = edges @ geometry.transforms[instance].reshape(3, 4)[:, :3].astype(np.float64).T
    area: np.ndarray = 0.5 * np.linalg.norm(np.cross(edges[:, 0], edges[:, 1]), axis=1)
    return np.where(np.isfinite(area), area, 0.0)


def _by_the_tree(lights: LightArrays) -> LightArrays:
    """Lights of which every part is sampled, the dim ones of the background too: scattering finds nothing there."""
    none = empty_map()
    return lights._replace(
        compensated_marginal=none.marginal, compensated_conditional=none.conditional, compensated_guide=none.guide
    )
