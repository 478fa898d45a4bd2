# SPDX-License-Identifier: GPL-3.0-or-later
"""Where rays start and end in place: at lamps in a surface, on unmoved copies, far from the origin, at touching glass.

Rays start a rounding error off the surface that they leave, and end as far before their light. What lies within it,
such as the ceiling that a lamp was snapped to, would shadow nothing. In Cycles rays skip the very triangles that they
start and end on, and no other. Here they do so where it shows, since it takes a tenth more time: at flat lamps in the
plane of a surface, on coincident faces (`engine.builder.coincident`) and copies that were never moved, on glass that
may touch something and on what it may touch, and on instances so far from the origin that the error is a part of their
size, or of that of what stands on them, as on curves and spheres.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from engine.builder.copies import unmoved_copies
from engine.builder.lamps import corners_of_flat
from engine.builder.touching_glass import touching_glass
from engine.builder.world_boxes import REACH, WorldBoxes, are_round, has_triangles, world_boxes, world_matrices
from engine.kernels.surface import RELATIVE_ERROR
from engine.scene.description import VISIBLE_SHADOW, Light, Notice
from engine.state import geometry as layout
from engine.state.geometry import GeometryArrays

#: How large the rounding error of a point may be, relative to the size of its instance; and that of all its points,
#: relative to the size of the scene's smaller instances, which may stand on it.
_LARGEST_ERROR, _LARGEST_ERROR_BESIDE_OTHERS = 1e-3, 3e-2
#: Vertices and triangles that are looked at for lamps; of further lamps nothing is known. About 0.1 s.
_MOST_LOOKS = 20_000_000
#: What else takes time, in the same measure: an instance's box, what a lamp is near, a triangle in the lamp's plane.
_LOOKS_A_BOX, _LOOKS_AN_INSTANCE, _LOOKS_A_TRIANGLE_IN_PLANE = 10, 10_000, 10
#: Nothing is known either of instances that have more triangles in a lamp's plane.
_MOST_IN_PLANE = 100_000
#: Names in a notice.
_MOST_NAMES = 4


@dataclass(frozen=True)
class SamePlace:
    """Where rays start and end in place.

    Attributes
    ----------
    instances : bool (I,)
        Which are far from the origin for their size, unmoved copies, or glass that may touch something, or what it may
        touch; curves.
    is_clear : bool (I,)
        Which rays go straight through: not for coincident faces.
    lights : int64 (L,)
        Flat lamps in surfaces, or far from the origin: indices into `SceneDescription.lights`.
    notices : list of Notice
        Which lamps lie in what.
    """

    instances: npt.NDArray[np.bool_]
    is_clear: npt.NDArray[np.bool_]
    lights: npt.NDArray[np.int64]
    notices: list[Notice]

    def mark(self, geometry: GeometryArrays, coincident: npt.NDArray[np.bool_]) -> GeometryArrays:
        """The geometry with these instances marked, and those with coincident faces; the same one without any."""
        instances = self.instances | coincident
        if not instances.any():
            return geometry
        table = geometry.instance_table.copy()
        table[instances, layout.INSTANCE_FLAGS] |= layout.INSTANCE_FLAG_IN_PLACE
        return geometry._replace(instance_table=table)


def _are_far(extent: np.ndarray, size: np.ndarray) -> npt.NDArray[np.bool_]:
    """Whether rounding errors of coordinates show on what is so large, and has any size."""
    far: npt.NDArray[np.bool_] = (extent * RELATIVE_ERROR > _LARGEST_ERROR * size) & (size > 0.0)
    return far


def _far_instances(boxes: WorldBoxes, is_there: npt.NDArray[np.bool_]) -> npt.NDArray[np.bool_]:
    """Instances on which rounding errors show, or beside which."""
    sizes = (boxes.high - boxes.low).max(axis=1, initial=0.0)
    usual = sizes[is_there & (sizes > 0.0) & (sizes < np.inf)]
    if not len(usual):
        return np.zeros(len(sizes), bool)
    from_origin = np.maximum(boxes.low, -boxes.high).max(axis=1)
    is_beyond = from_origin * RELATIVE_ERROR > _LARGEST_ERROR_BESIDE_OTHERS * np.quantile(usual, 0.25, method="lower")
    far: npt.NDArray[np.bool_] = is_there & (_are_far(boxes.extent, sizes) | is_beyond)
    return far


def _overlaps(quad: np.ndarray, triangles: np.ndarray, least: float) -> bool:
    """Whether one of the triangles (T, 3, 2) overlaps a parallelogram (4, 2) by more than so much in one plane."""
    # Corner by corner, several times as fast as all three at once.
    is_above, is_below = (
        (of[:, 0] | of[:, 1] | of[:, 2]) for of in (triangles >= quad.min(axis=0), triangles <= quad.max(axis=0))
    )
    triangles = triangles[(is_above & is_below).all(axis=1)]
    apart = np.zeros(len(triangles), bool)
    quads = np.broadcast_to(quad, (len(triangles), 4, 2))
    for ours, others in ((triangles, quads), (quads, triangles)):
        for k in range(ours.shape[1]):
            start = ours[:, k]
            along = ours[:, (k + 1) % ours.shape[1]] - start
            normal = np.stack([along[:, 1], -along[:, 0]], axis=1)
            inside = ((ours[:, (k + 2) % ours.shape[1]] - start) * normal).sum(axis=1)
            depths = ((others - start[:, None]) * normal[:, None]).sum(axis=2) * np.sign(inside)[:, None]
            apart |= depths.max(axis=1) <= least * np.linalg.norm(normal, axis=1)
    return not apart.all()


@dataclass(frozen=True)
class _Plane:
    """A plane, and what of an instance lies in it.

    origin : float64 (3,), world; axes : float64 (3, 2), unit vectors in the plane
    triangles : float64 (T, 3, 2), corners from the origin along the axes
    """

    origin: np.ndarray
    axes: np.ndarray
    triangles: np.ndarray


def _triangles_in(
    geometry: GeometryArrays, instance: int, matrix: np.ndarray, origin: np.ndarray, normal: np.ndarray, reach: float
) -> np.ndarray:
    """Corners of the triangles of an instance whose corners all lie that near to a plane, world, float64 (T, 3, 3)."""
    mesh = geometry.mesh_table[geometry.instance_table[instance, layout.INSTANCE_MESH]]
    first, size = int(mesh[layout.MESH_FIRST_VERTEX]), int(mesh[layout.MESH_VERTEX_COUNT])
    start, count = int(mesh[layout.MESH_FIRST_TRIANGLE]), int(mesh[layout.MESH_TRIANGLE_COUNT])
    vertices = geometry.vertices[first : first + size, :3]
    # float32 is enough, and several times as fast: it is far better than the error.
    height = vertices @ (normal @ matrix[:, :3]).astype(np.float32) - np.float32(normal @ (origin - matrix[:, 3]))
    is_near = np.abs(height) <= reach
    kept = np.zeros(0, np.int64)
    if np.count_nonzero(is_near) >= 3:
        triangles = geometry.triangles[start : start + count]
        kept = np.flatnonzero(is_near[triangles[:, 0] - np.uint32(first)])
        for corner in (1, 2):
            kept = kept[is_near[triangles[kept, corner] - np.uint32(first)]]
    if len(kept) > _MOST_IN_PLANE:
        kept = kept[:0]
    corners: np.ndarray = vertices[geometry.triangles[start + kept].astype(np.int64) - first].astype(np.float64)
    return corners @ matrix[:, :3].T + matrix[:, 3]


def _surfaces_of(
    quads: np.ndarray, geometry: GeometryArrays, matrices: np.ndarray, boxes: WorldBoxes
) -> list[list[int]]:
    """The instances, of those that shadow, in which each lamp lies."""
    table = geometry.instance_table
    counts = geometry.mesh_table[table[:, layout.INSTANCE_MESH]]
    looks = counts[:, layout.MESH_VERTEX_COUNT] + counts[:, layout.MESH_TRIANGLE_COUNT].astype(np.int64)
    shadows = has_triangles(geometry) & ~are_round(geometry)
    shadows &= (table[:, layout.INSTANCE_VISIBILITY] & VISIBLE_SHADOW) != 0
    found: list[list[int]] = [[] for _ in quads]
    # Only the first of the lamps in one ceiling looks at all of it.
    planes: dict[tuple[float, ...], _Plane] = {}
    looked = 0
    for of_lamp, quad in zip(found, quads, strict=True):
        looked += len(table) * _LOOKS_A_BOX
        along = quad[1] - quad[0]
        normal = np.cross(along, quad[3] - quad[0])
        area = float(np.linalg.norm(normal))
        if not 0.0 < area < np.inf or looked > _MOST_LOOKS:
            continue
        normal, along = normal / area, along / np.linalg.norm(along)
        errors = RELATIVE_ERROR * np.maximum(boxes.extent, np.abs(quad).max())
        low, high = quad.min(axis=0) - REACH * errors[:, None], quad.max(axis=0) + REACH * errors[:, None]
        for instance in np.flatnonzero(shadows & ((boxes.low <= high) & (boxes.high >= low)).all(axis=1)).tolist():
            error = float(errors[instance])
            key = (instance, *np.round(normal, 6).tolist(), round(float(normal @ quad[0]) / error))
            looked += _LOOKS_AN_INSTANCE + (0 if key in planes else int(looks[instance]))
            if looked > _MOST_LOOKS:
                break
            if key not in planes:
                axes = np.stack([along, np.cross(normal, along)], axis=1)
                corners = _triangles_in(geometry, instance, matrices[instance], quad[0], normal, REACH * error)
                planes[key] = _Plane(quad[0], axes, (corners - quad[0]) @ axes)
            plane = planes[key]
            looked += len(plane.triangles) * _LOOKS_A_TRIANGLE_IN_PLANE
            if _overlaps((quad - plane.origin) @ plane.axes, plane.triangles, 2.0 * REACH * error):
                of_lamp.append(instance)
    return found


def _listed(names: Iterable[str]) -> str:
    """Names in words, the first few of them."""
    known = sorted(set(names))
    rest = len(known) - _MOST_NAMES
    return ", ".join(known[:_MOST_NAMES]) + (f" and {rest} more" if rest > 0 else "")


def find_same_place(
    geometry: GeometryArrays, lights: Sequence[Light], names: Sequence[str], is_glass: npt.NDArray[np.bool_],
    is_clear: npt.NDArray[np.bool_],
) -> SamePlace:  # fmt: skip
    """Find lamps that lie in surfaces, what is far from the origin, copies, and glass that may touch something.

    Parameters
    ----------
    names : sequence of str (I,)
        Names of the instances' objects.
    is_glass : bool (I,)
        Which instances have a material that bends light.
    is_clear : bool (I,)
        Which have one that rays go straight through. These would go back and forth between copies, skipping one each.
    """
    # Vertices may be infinite, or not a number: these are in no place.
    with np.errstate(all="ignore"):
        matrices = world_matrices(geometry)
        boxes = world_boxes(geometry, matrices)
        quads, of_lights = corners_of_flat(lights)
        instances = _far_instances(boxes, has_triangles(geometry)) | touching_glass(
            geometry, matrices, boxes, is_glass
        )
        instances |= unmoved_copies(geometry, boxes) & ~is_clear
        # Strands are as thin as the error.
        instances |= are_round(geometry)
        sizes = (quads.max(axis=1) - quads.min(axis=1)).max(axis=1, initial=0.0)
        is_far_lamp = _are_far(np.abs(quads).max(axis=(1, 2), initial=0.0), sizes)
        surfaces = _surfaces_of(quads, geometry, matrices, boxes)
    notices = [
        Notice(
            f"light {lights[light].name}", f"it lies in {_listed(names[k] for k in inside)}",
            "that shadows it unless it is transparent, as in Cycles: move it off by a millimetre",
        )
        for light, inside in zip(of_lights.tolist(), surfaces, strict=True) if inside
    ]  # fmt: skip
    in_place = is_far_lamp | np.array([bool(inside) for inside in surfaces], bool)
    return SamePlace(instances=instances, is_clear=is_clear, lights=of_lights[in_place], notices=notices)
