# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves while the shutter is open, as keys between which positions go straight.

Hosts give transforms at a few times, between which things turn. Embree can turn them too, but by an approximation that
puts a surface beside the place where its shading is computed. Instead turns get so many keys that straight lines
between them stray from the arc by less than can be seen, and both sides compute the same positions.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.array_types import Float32Array
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: Keys of a geometry that Embree takes at most.
MOST_KEYS = 129
#: Turn between two keys [rad]: points stray from the arc by an eighth of its square times their distance from the axis.
_LARGEST_TURN = 0.025


def _decompose(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Rotations as quaternions (N, S, 4), w first, and what is left of the linear parts (N, S, 3, 3).

    A linear part is a rotation times an upper triangular matrix (scale and shear), all negative where it mirrors.
    Neighbouring quaternions lie on the same side, so that things turn the shorter way.
    """
    rotation, rest = np.linalg.qr(matrices[:, :, :3, :3])
    signs = np.where(np.diagonal(rest, axis1=2, axis2=3) < 0.0, -1.0, 1.0)
    rotation, rest = rotation * signs[:, :, None, :], rest * signs[..., None]
    mirrored = np.where(np.linalg.det(rotation) < 0.0, -1.0, 1.0)[..., None, None]
    rotation, rest = rotation * mirrored, rest * mirrored
    quaternions = _quaternions(rotation.reshape(-1, 3, 3)).reshape(*matrices.shape[:2], 4)
    for step in range(1, matrices.shape[1]):
        away = np.einsum("ij,ij->i", quaternions[:, step - 1], quaternions[:, step]) < 0.0
        quaternions[away, step] *= -1.0
    return quaternions, rest


def _quaternions(r: np.ndarray) -> np.ndarray:
    """Unit quaternions (N, 4), (w, x, y, z), of rotation matrices (N, 3, 3).

    References: Shepperd 1978, "Quaternion from Rotation Matrix": from the largest component, so that none is small.
    """
    xx, yy, zz = r[:, 0, 0], r[:, 1, 1], r[:, 2, 2]
    wx, wy, wz = r[:, 2, 1] - r[:, 1, 2], r[:, 0, 2] - r[:, 2, 0], r[:, 1, 0] - r[:, 0, 1]
    xy, xz, yz = r[:, 0, 1] + r[:, 1, 0], r[:, 0, 2] + r[:, 2, 0], r[:, 1, 2] + r[:, 2, 1]
    squares = np.stack([1.0 + xx + yy + zz, 1.0 + xx - yy - zz, 1.0 - xx + yy - zz, 1.0 - xx - yy + zz], axis=1)
    rows = np.stack([
        squares[:, 0], wx, wy, wz, wx, squares[:, 1], xy, xz, wy, xy, squares[:, 2], yz, wz, xz, yz, squares[:, 3]
    ], axis=1).reshape(-1, 4, 4)  # fmt: skip
    chosen = rows[np.arange(len(r)), np.argmax(squares, axis=1)]
    return chosen / np.linalg.norm(chosen, axis=1)[:, None]


def _rotations(quaternions: np.ndarray) -> np.ndarray:
    """Rotation matrices (..., 3, 3) of unit quaternions (..., 4)."""
    w, x, y, z = np.moveaxis(quaternions, -1, 0)
    return np.stack([
        1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - w * z), 2.0 * (x * z + w * y),
        2.0 * (x * y + w * z), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - w * x),
        2.0 * (x * z - w * y), 2.0 * (y * z + w * x), 1.0 - 2.0 * (x * x + y * y),
    ], axis=-1).reshape(*quaternions.shape[:-1], 3, 3)  # fmt: skip


def interpolation_keys(transforms: Float32Array) -> Float32Array:
    """Keys, float32 (K, 12), between which a motion, float32 (S, 4, 4), is straight: see `keys_of_motions`."""
    return keys_of_motions([transforms])[0]


def keys_of_motions(motions: Sequence[Float32Array]) -> list[Float32Array]:
    """Keys of each motion, between which it is straight.

    Parameters
    ----------
    motions : sequence of float32 (S, 4, 4), S >= 2
        Affine and invertible transforms at evenly spaced times. Between them translation, scale and shear change
        evenly, and rotations along the shorter arc at even speed (Shoemake 1985, "Animating Rotation with Quaternion
        Curves").

    Returns
    -------
    list of float32 (K, 12)
        At evenly spaced times; S of them where nothing turns, never more than `MOST_KEYS`.

    Raises
    ------
    ValueError
        For fewer than two transforms, or more than Embree takes.
    """
    keys: list[Float32Array] = [np.zeros((0, 12), np.float32)] * len(motions)
    counts = np.array([len(motion) for motion in motions], np.int64)
    for count in np.unique(counts).tolist():
        if not 2 <= count <= MOST_KEYS:
            raise ValueError(f"a motion of {count} steps: give 2 to {MOST_KEYS}")
        rows = np.flatnonzero(counts == count)
        matrices = np.stack([motions[row] for row in rows.tolist()]).astype(np.float64)
        quaternions, rests = _decompose(matrices)
        cosines = np.einsum("nsi,nsi->ns", quaternions[:, :-1], quaternions[:, 1:])
        angles = np.arccos(np.clip(cosines, -1.0, 1.0))  # half the turn
        wanted = np.ceil(2.0 * angles.max(axis=1) / _LARGEST_TURN).astype(np.int64)
        finer = np.clip(wanted, 1, (MOST_KEYS - 1) // (count - 1))
        for factor in np.unique(finer).tolist():
            some = np.flatnonzero(finer == factor)
            found = _keys(matrices[some], quaternions[some], rests[some], angles[some], factor)
            for row, each in zip(rows[some].tolist(), found, strict=True):
                keys[row] = each
    return keys


def _keys(
    matrices: np.ndarray, quaternions: np.ndarray, rests: np.ndarray, angles: np.ndarray, finer: int
) -> Float32Array:
    """Keys, float32 (N, K, 12), of N motions whose steps, as `_decompose` has them, are each divided by `finer`."""
    count = matrices.shape[1]
    if finer == 1:
        return np.ascontiguousarray(matrices[:, :, :3].reshape(-1, count, 12), np.float32)
    at = np.arange((count - 1) * finer + 1) / finer
    step = np.minimum(at.astype(int), count - 2)
    fraction = (at - step)[:, None]
    angle = np.maximum(angles[:, step], 1e-9)[..., None]
    before, after = quaternions[:, step], quaternions[:, step + 1]
    turned = (np.sin((1.0 - fraction) * angle) * before + np.sin(fraction * angle) * after) / np.sin(angle)
    turned /= np.linalg.norm(turned, axis=-1, keepdims=True)
    rest = rests[:, step] + fraction[:, :, None] * (rests[:, step + 1] - rests[:, step])
    translations = matrices[:, :, :3, 3]
    keys = np.empty((len(matrices), len(at), 3, 4))
    keys[..., :3] = _rotations(turned) @ rest
    keys[..., 3] = translations[:, step] + fraction * (translations[:, step + 1] - translations[:, step])
    # Where the host says where things are, they are there.
    keys[:, ::finer] = matrices[:, :, :3]
    return np.ascontiguousarray(keys.reshape(len(matrices), len(at), 12), np.float32)


def _shapes(geometry: GeometryArrays, mesh: int, triangles: np.ndarray) -> list[np.ndarray]:
    """Corners (T, 3, 3), float64, in the space the mesh is stored in: at each of its steps, or as it always is."""
    rows = geometry.triangles[triangles].astype(np.int64)
    row = geometry.mesh_table[mesh]
    motion = int(row[layout.MESH_MOTION])
    if motion < 0:
        return [geometry.vertices[rows][:, :, :3].astype(np.float64)]
    steps, first = geometry.motion_table[motion, : layout.MOTION_FIRST_VERTEX + 1].tolist()
    rows = rows - int(row[layout.MESH_FIRST_VERTEX]) + first
    length = int(row[layout.MESH_VERTEX_COUNT])
    return [geometry.vertices[rows + step * length][:, :, :3].astype(np.float64) for step in range(steps)]


def _matrices(geometry: GeometryArrays, instance: int) -> list[np.ndarray]:
    """Object to world (3, 4), float64, at each key of an instance; none where it is stored in world space."""
    row = geometry.instance_table[instance]
    flags = int(row[layout.INSTANCE_FLAGS])
    if flags & layout.INSTANCE_FLAG_BAKED:
        return []
    if flags & layout.INSTANCE_FLAG_MOVING:
        first, count = int(row[layout.INSTANCE_FIRST_KEY]), int(row[layout.INSTANCE_KEY_COUNT])
        return list(geometry.motion_transforms[first : first + count].reshape(-1, 3, 4).astype(np.float64))
    return [geometry.transforms[instance].reshape(3, 4).astype(np.float64)]


def is_in_motion(geometry: GeometryArrays, instance: int) -> bool:
    """Whether an instance moves or changes its shape while the shutter is open."""
    row = geometry.instance_table[instance]
    is_moving = bool(row[layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_MOVING)
    return is_moving or bool(geometry.mesh_table[row[layout.INSTANCE_MESH], layout.MESH_MOTION] >= 0)


def world_corners(geometry: GeometryArrays, instance: int, triangles: np.ndarray) -> np.ndarray:
    """Corners of triangles of an instance at the middle of the shutter, float64 (T, 3, 3), world space [m].

    Parameters
    ----------
    triangles : int (T,), rows of `geometry.triangles`
    """
    corners = geometry.vertices[geometry.triangles[triangles]][:, :, :3].astype(np.float64)
    if not geometry.instance_table[instance, layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_BAKED:
        matrix = geometry.transforms[instance].reshape(3, 4).astype(np.float64)
        corners = corners @ matrix[:, :3].T + matrix[:, 3]
    return corners


def corners_in_motion(geometry: GeometryArrays, instance: int, triangles: np.ndarray) -> list[np.ndarray]:
    """As `world_corners`, of each shape at each key: between any two times corners lie within the hull of these."""
    mesh = int(geometry.instance_table[instance, layout.INSTANCE_MESH])
    shapes, matrices = _shapes(geometry, mesh, triangles), _matrices(geometry, instance)
    if not matrices:
        return shapes
    return [shape @ matrix[:, :3].T + matrix[:, 3] for matrix in matrices for shape in shapes]
