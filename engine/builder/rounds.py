# SPDX-License-Identifier: GPL-3.0-or-later
"""Radii of curves and spheres, checked and laid one after the other."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array, Int32Array
from engine.scene.description import Mesh, Notice
from engine.scene.rounds import RIBBONS, ROUND, ROUND_LINEAR, SPHERES, Rounds
from engine.state import geometry as layout

#: Numbers of `Rounds.shape` in `MESH_SHAPE`.
SHAPES = {
    RIBBONS: layout.SHAPE_RIBBONS,
    ROUND: layout.SHAPE_ROUND,
    ROUND_LINEAR: layout.SHAPE_ROUND_LINEAR,
    SPHERES: layout.SHAPE_SPHERES,
}


def is_uniform(matrix: Float32Array) -> bool:
    """Whether an affine map (3 or 4, 4) keeps round things round, which have no other radius in world space.

    It does where its rows and columns are equally long, up to 1e-6 of squares [m^2], as in Cycles.
    """
    linear = np.asarray(matrix[:3, :3], np.float64)
    squares = np.concatenate([(linear**2).sum(axis=axis) for axis in (0, 1)])
    return bool((np.abs(squares - squares[0]) < 1e-6).all())


def _radii_of_steps(rounds: Rounds, count: int) -> np.ndarray:
    motion, shape = rounds.motion_radii, (count, len(rounds.radii))
    return motion if motion is not None and motion.shape == shape else np.broadcast_to(rounds.radii, shape)


def lay_radii(
    meshes: Sequence[Mesh], transforms: Sequence[Float32Array | None], step_counts: Sequence[int],
    notices: list[Notice],
) -> tuple[Float32Array, Int32Array]:
    """Radii of all vertices of curves and spheres, float32 (R,), and where those of each mesh begin, -1 = it has none.

    Where a mesh changes its shape at so many steps, those of its steps follow, as its vertices' do.

    Where a mesh is to be stored in world space, `transforms` has its own: radii grow by the cube root of the growth in
    volume, as in Cycles.
    """
    firsts = np.full(len(meshes), -1, np.int32)
    parts: list[np.ndarray] = []
    total = 0
    for index, (mesh, transform, step_count) in enumerate(zip(meshes, transforms, step_counts, strict=True)):
        if mesh.rounds is None:
            continue
        radii = np.asarray(mesh.rounds.radii, np.float32)
        if step_count:
            radii = np.concatenate([radii, _radii_of_steps(mesh.rounds, step_count).ravel()])
        is_good = np.isfinite(radii) & (radii >= 0.0)
        if not is_good.all():
            problem = f"{int((~is_good).sum())} radii are negative, NaN or infinite"
            notices.append(Notice(f"mesh {mesh.name}", problem, "they are 0"))
            radii = np.where(is_good, radii, np.float32(0.0))
        if transform is not None:
            growth = abs(np.linalg.det(transform[:3, :3].astype(np.float64)))
            radii = radii * np.float32(np.cbrt(growth))
        firsts[index] = total
        parts.append(radii)
        total += len(radii)
    return np.concatenate(parts) if parts else np.zeros(0, np.float32), firsts
