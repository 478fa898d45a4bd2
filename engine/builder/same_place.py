# SPDX-License-Identifier: GPL-3.0-or-later
"""What lies in one place with area lamps, and what is so far from the origin that a rounding error shows.

Rays start a rounding error off the surface that they leave, and end as far before their light. What lies within it,
such as the ceiling that a lamp was snapped to, would shadow nothing. In Cycles rays skip the very triangles that they
start and end on, and no other. So here rays do the same where something is *touched*: triangles and lamps that share a
plane and overlap, and as a whole instances that are too far from the origin for their size.

Surfaces in one place that no lamp is near are not searched for: they shadow each other in Cycles, and not here
(docs/differences.md).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.accel import MeshHierarchies, visit_pairs
from engine.array_types import Uint8Array, Uint32Array
from engine.builder.boundaries import APART
from engine.kernels.coplanar import compare, enclose
from engine.kernels.surface import RELATIVE_ERROR
from engine.runtime.jit import Kernel
from engine.scene.description import Light, Notice
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: Triangles that are searched.
_MOST_TRIANGLES = 4_000_000
#: How large the rounding error of a point may be, relative to the size of its mesh.
_LARGEST_ERROR = 1e-3
#: Lamps whose boxes triangles are compared with; where there are more, all triangles are searched.
_MOST_BOXES = 64
#: Names in a notice.
_MOST_NAMES = 4
_NONE = 0xFFFFFFFF


@dataclass(frozen=True)
class SamePlace:
    """What is touched.

    Attributes
    ----------
    triangles : uint8 (T,)
        Whether a row of `GeometryArrays.triangles` is; (0,) where none is.
    instances : bool (I,)
        Which are touched as a whole.
    lights : int64 (L,)
        Indices into `SceneDescription.lights`.
    notices : list of Notice
    """

    triangles: Uint8Array
    instances: npt.NDArray[np.bool_]
    lights: npt.NDArray[np.int64]
    notices: list[Notice]

    def mark(self, geometry: GeometryArrays) -> GeometryArrays:
        """The geometry with what is touched; the same one where nothing is."""
        if not len(self.triangles) and not self.instances.any():
            return geometry
        table = geometry.instance_table.copy()
        table[self.instances, layout.INSTANCE_FLAGS] |= layout.INSTANCE_FLAG_TOUCHED
        return geometry._replace(touched=self.triangles, instance_table=table)


@dataclass(frozen=True)
class _Searched:
    """Triangles one after the other.

    corners : uint32 (P, 3), rows of the geometry's vertices, or behind them of `further`, float32 (W, 3), world
    rows : int64 (P,), of `GeometryArrays.triangles`, -1 = of a lamp
    first : int64 (G,), of the triangles of one owner; owner : int64 (G,), instance, or index of the light
    """

    corners: Uint32Array
    further: np.ndarray
    first: np.ndarray
    rows: np.ndarray
    owner: np.ndarray

    def end(self, group: int) -> int:
        """Behind the last triangle of a group."""
        return int(self.first[group + 1]) if group + 1 < len(self.first) else len(self.corners)

    def group(self, numbers: np.ndarray) -> np.ndarray:
        """Groups that triangles are in."""
        return np.searchsorted(self.first, numbers, side="right") - 1


def _mesh_boxes(geometry: GeometryArrays) -> tuple[np.ndarray, np.ndarray]:
    """Middles and half sizes of meshes, float64 (M, 3), of their first shapes."""
    middle = np.zeros((len(geometry.mesh_table), 3))
    half = np.zeros_like(middle)
    rows = np.flatnonzero(geometry.mesh_table[:, layout.MESH_VERTEX_COUNT] > 0)
    if len(rows):
        first, count = geometry.mesh_table[rows][:, [layout.MESH_FIRST_VERTEX, layout.MESH_VERTEX_COUNT]].T
        # Behind each mesh's vertices may be others, of its further steps or of no mesh.
        ends = np.stack([first, first + count], axis=1).ravel().astype(np.int64)
        ends = ends[:-1] if ends[-1] == len(geometry.vertices) else ends
        low = np.minimum.reduceat(geometry.vertices, ends)[::2].astype(np.float64)
        high = np.maximum.reduceat(geometry.vertices, ends)[::2].astype(np.float64)
        middle[rows], half[rows] = 0.5 * (low + high), 0.5 * (high - low)
    return middle, half


@dataclass(frozen=True)
class _Boxes:
    """World-space boxes of all instances, float64 (I, 3), and the largest coordinate on the way there, float64 (I,)."""

    low: np.ndarray
    high: np.ndarray
    extent: np.ndarray


def _boxes(geometry: GeometryArrays) -> _Boxes:
    middle, half = (found[geometry.instance_table[:, layout.INSTANCE_MESH]] for found in _mesh_boxes(geometry))
    matrices = geometry.transforms.astype(np.float64).reshape(-1, 3, 4)
    is_baked = (geometry.instance_table[:, layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_BAKED) != 0
    matrices = np.where(is_baked[:, None, None], np.eye(3, 4), matrices)
    linear = np.abs(matrices[:, :, :3])
    half_size = (linear @ half[:, :, None])[:, :, 0]
    at = (matrices[:, :, :3] @ middle[:, :, None])[:, :, 0] + matrices[:, :, 3]
    within = (linear @ (np.abs(middle) + half)[:, :, None])[:, :, 0]
    return _Boxes(at - half_size, at + half_size, np.maximum(np.abs(at) + half_size, within).max(axis=1))


def _lamp_corners(lights: Sequence[Light]) -> tuple[np.ndarray, np.ndarray]:
    """Corners of area lamps, float32 (K, 4, 3), and their indices; of round ones those of the squares around them."""
    index = [k for k, light in enumerate(lights) if light.kind == "AREA" and np.isfinite(light.transform).all()]
    corners = np.zeros((len(index), 4, 3))
    for row, k in enumerate(index):
        light, matrix = lights[k], np.asarray(lights[k].transform, np.float64)
        size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
        along = 0.5 * matrix[:3, 0] * light.size_x, 0.5 * matrix[:3, 1] * size_y
        corners[row] = [matrix[:3, 3] + a * along[0] + b * along[1] for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
    return corners.astype(np.float32), np.array(index, np.int64)


def _near_others(corners: np.ndarray, low: np.ndarray, high: np.ndarray) -> npt.NDArray[np.bool_]:
    """Which triangles, float32 (T, 3, 3), meet some of the boxes (K, 3)."""
    if len(low) > _MOST_BOXES:
        return np.ones(len(corners), bool)
    least, most = corners.min(axis=1), corners.max(axis=1)
    found = np.zeros(len(corners), bool)
    for of_low, of_high in zip(low, high, strict=True):
        found |= ((least <= of_high) & (most >= of_low)).all(axis=1)
    return found


def _gather(
    geometry: GeometryArrays, lights: Sequence[Light], standing: np.ndarray, placed: np.ndarray
) -> _Searched:
    """Area lamps, and what meets their boxes of instances; `standing` are those that are stored in world space."""
    table, meshes = geometry.instance_table, geometry.mesh_table
    quads, of_lights = _lamp_corners(lights)
    reach = APART * np.abs(quads).max(axis=(1, 2), initial=0.0)[:, None]
    low, high = quads.min(axis=1) - reach, quads.max(axis=1) + reach
    corners, further, rows, owner, behind = [], [], [], [], len(geometry.vertices)

    def add(triangles: np.ndarray, numbers: np.ndarray, of: int) -> None:
        corners.append(triangles)
        rows.append(numbers)
        owner.append(of)

    for k in np.concatenate([standing, placed]).tolist():
        mesh = int(table[k, layout.INSTANCE_MESH])
        row, count = (int(meshes[mesh, c]) for c in (layout.MESH_FIRST_TRIANGLE, layout.MESH_TRIANGLE_COUNT))
        first, size = (int(meshes[mesh, c]) for c in (layout.MESH_FIRST_VERTEX, layout.MESH_VERTEX_COUNT))
        local = geometry.triangles[row : row + count].astype(np.int64) - first
        at = geometry.vertices[first : first + size]
        is_baked = bool(table[k, layout.INSTANCE_FLAGS] & layout.INSTANCE_FLAG_BAKED)
        if not is_baked:
            matrix = geometry.transforms[k].reshape(3, 4)
            at = at @ matrix[:, :3].T + matrix[:, 3]
        kept = np.flatnonzero(_near_others(at[local], low, high))
        if not len(kept):
            continue
        add(local[kept] + (first if is_baked else behind), kept + row, k)
        if not is_baked:
            further.append(at)
            behind += size
    further.append(quads.reshape(-1, 3))
    for quad, light in enumerate(of_lights.tolist()):
        add(np.array([(0, 1, 2), (0, 2, 3)]) + behind + 4 * quad, np.full(2, -1), light)
    sizes = np.array([len(part) for part in corners], np.int64)
    nothing = np.zeros((0, 3), np.uint32)
    return _Searched(
        corners=np.ascontiguousarray(np.concatenate([nothing, *corners]), np.uint32),
        further=np.ascontiguousarray(np.concatenate(further), np.float32),
        rows=np.concatenate([np.zeros(0, np.int64), *rows]),
        first=np.cumsum(sizes) - sizes,
        owner=np.array(owner, np.int64),
    )


def _search(
    geometry: GeometryArrays, searched: _Searched, hierarchies: MeshHierarchies
) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of the triangles that lie in one place with others, and of each one of these."""
    found = np.full(len(searched.corners), _NONE, np.uint32)
    task = np.array(
        [geometry.vertices.ctypes.data, searched.further.ctypes.data, len(geometry.vertices),
         searched.corners.ctypes.data, found.ctypes.data], np.int64,
    )  # fmt: skip
    if len(found) > 1 and isinstance(compare, Kernel):
        visit_pairs(hierarchies, len(found), int(task.ctypes.data), enclose, compare)
    numbers = np.flatnonzero(found != _NONE)
    return numbers, found[numbers].astype(np.int64)


def _listed(names: Iterable[str]) -> str:
    """Names in words, the first few of them."""
    known = sorted(set(names))
    rest = len(known) - _MOST_NAMES
    return ", ".join(known[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def _notices(
    searched: _Searched, numbers: np.ndarray, others: np.ndarray, names: Sequence[str], lights: Sequence[Light]
) -> list[Notice]:
    """What to say of lamps that surfaces hide."""
    is_told = (searched.rows[numbers] < 0) & (searched.rows[others] >= 0)
    owner, of_other = searched.owner[searched.group(numbers)], searched.owner[searched.group(others)]
    found = []
    for light in np.unique(owner[is_told]).tolist():
        where = _listed(names[k] for k in of_other[is_told & (owner == light)].tolist())
        problem, fallback = f"it lies in {where}", "that shadows it, as in Cycles: move it off by a millimetre"
        found.append(Notice(f"light {lights[light].name}", problem, fallback))
    return found


def find_same_place(
    geometry: GeometryArrays, lights: Sequence[Light], names: Sequence[str], hierarchies: MeshHierarchies,
    *, only_standing: bool = False,
) -> SamePlace:
    """Find what lies in one place.

    Parameters
    ----------
    names : sequence of str (I,)
        Of the instances' objects.
    hierarchies : MeshHierarchies
        Whose device searches.
    only_standing : bool
        Whether to search only what is stored in world space, which what is moved about leaves as it is.

    Raises
    ------
    MemoryError, RuntimeError
        When Embree reports an error.
    """
    table = geometry.instance_table
    meshes = geometry.mesh_table[table[:, layout.INSTANCE_MESH]]
    flags, count = table[:, layout.INSTANCE_FLAGS], meshes[:, layout.MESH_TRIANGLE_COUNT].astype(np.int64)
    is_there = (count > 0) & (table[:, layout.INSTANCE_VISIBILITY] != 0)
    is_still = ((flags & layout.INSTANCE_FLAG_MOVING) == 0) & (meshes[:, layout.MESH_MOTION] < 0)
    boxes = _boxes(geometry)
    is_far = boxes.extent * RELATIVE_ERROR > _LARGEST_ERROR * (boxes.high - boxes.low).max(axis=1, initial=0.0)
    has_lamps = any(light.kind == "AREA" for light in lights)
    searchable = is_there & is_still & ~is_far & has_lamps
    is_baked = (flags & layout.INSTANCE_FLAG_BAKED) != 0
    standing, placed = np.flatnonzero(searchable & is_baked), np.flatnonzero(searchable & ~is_baked)
    if only_standing or count[standing].sum() + count[placed].sum() > _MOST_TRIANGLES:
        placed = placed[:0]
    if count[standing].sum() > _MOST_TRIANGLES:
        standing = standing[:0]
    searched = _gather(geometry, lights, standing, placed)
    numbers, others = _search(geometry, searched, hierarchies)
    is_lamp = searched.rows[numbers] < 0
    touched = np.zeros(0, np.uint8)
    if not is_lamp.all():
        touched = np.zeros(len(geometry.triangles), np.uint8)
        touched[searched.rows[numbers[~is_lamp]]] = 1
    return SamePlace(
        triangles=touched,
        instances=is_there & is_far,
        lights=np.unique(searched.owner[searched.group(numbers[is_lamp])]),
        notices=_notices(searched, numbers, others, names, lights),
    )
