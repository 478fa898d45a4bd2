# SPDX-License-Identifier: GPL-3.0-or-later
"""Faces in one place with others: found by rays, from points on all meshes, through a hierarchy at hand.

Rays start in place on the instances that have such faces (`engine.builder.same_place`), so that they shadow each other
as in Cycles. Where nobody can see both, such as under a box that stands on a floor or between two boxes, it would only
cost time: rays around the point tell that by meeting nothing but backs.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import numpy.typing as npt

from engine.accel.accelerator import Accelerator
from engine.accel.ray_words import NONE
from engine.accel.rays import read_hit, trace_closest, trace_closest_from
from engine.accel.scratch import RayScratch
from engine.accel.skipped_triangles import start_on
from engine.builder.world_boxes import REACH, are_round, has_triangles
from engine.kernels.surface import surface_point
from engine.kernels.vector import add, cross, dot, normalize, scale
from engine.runtime.jit import kernel
from engine.state import geometry as layout
from engine.state.geometry import INSTANCE_MESH, MESH_SHAPE, SHAPE_TRIANGLES, GeometryArrays

#: Points that are looked at: about 0.05 s. Of those of an instance that has too many, so many at least.
_MOST_POINTS, _FEWEST_POINTS = 1 << 15, 16
#: Points of a triangle, as barycentric coordinates of its second and third corner: no plain fractions, where edges of
#: other things often are.
_POINTS = np.array([(0.359, 0.313), (0.173, 0.151), (0.659, 0.187), (0.163, 0.691)], np.float32)
#: Steps through an instance's triangles: the golden ratio spreads any number of them.
_GOLDEN = 0.6180339887498949
#: The least cosine between normals of faces in one place: others cross.
_PARALLEL = np.float32(0.999)
#: Rays that look around on one side of a point, and how far they lean to the side.
_LOOKS, _LEAN = 4, np.float32(0.7)
#: The middle of the shutter.
_TIME = np.float32(0.5)


def _points_of(geometry: GeometryArrays) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Points on instances of triangles: instances, triangles, int32 (P,), and rows of `_POINTS`, int64 (P,)."""
    rows = np.flatnonzero(has_triangles(geometry) & ~are_round(geometry))
    if len(rows) * _FEWEST_POINTS > _MOST_POINTS:
        rows = rows[np.linspace(0, len(rows) - 1, _MOST_POINTS // _FEWEST_POINTS).astype(np.int64)]
    meshes = geometry.mesh_table[geometry.instance_table[rows, layout.INSTANCE_MESH]]
    sizes = meshes[:, layout.MESH_TRIANGLE_COUNT].astype(np.int64)
    share = min(1.0, (_MOST_POINTS - len(rows) * _FEWEST_POINTS) / max(len(_POINTS) * int(sizes.sum()), 1))
    wanted = np.maximum((len(_POINTS) * sizes * share).astype(np.int64), _FEWEST_POINTS)
    counts = np.minimum(wanted, len(_POINTS) * sizes)
    number = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    of = np.repeat(np.arange(len(rows)), counts)
    is_all = counts[of] == len(_POINTS) * sizes[of]
    spread = (number * _GOLDEN % 1.0 * sizes[of]).astype(np.int64)
    triangles = np.where(is_all, number // len(_POINTS), spread) + meshes[of, layout.MESH_FIRST_TRIANGLE]
    return rows[of].astype(np.int32), triangles.astype(np.int32), number % len(_POINTS)


@kernel
def _looks_closed(scene, geometry, ray, bits, address, p, n, along):
    """What rays meet on the side of a point that `n` points to.

    Returns
    -------
    is_closed : bool
        Nothing but backs, as within a body.
    meets_front : bool
    """
    is_closed, meets_front = True, False
    across = cross(n, along)
    for k in range(_LOOKS):
        x = _LEAN if k == 0 else -_LEAN if k == 1 else np.float32(0.0)
        y = _LEAN if k == 2 else -_LEAN if k == 3 else np.float32(0.0)
        direction = normalize(add(n, add(scale(along, x), scale(across, y))))
        if not trace_closest(
            scene, ray, bits, address, p, direction, np.float32(0.0), np.float32(np.inf), _TIME, NONE
        ):
            is_closed = False
            continue
        instance, triangle, _distance, u, v = read_hit(ray, bits, geometry)
        if geometry.mesh_table[geometry.instance_table[instance, INSTANCE_MESH], MESH_SHAPE] != SHAPE_TRIANGLES:
            is_closed = False
            continue
        _p, ng, _ns, _error = surface_point(geometry, instance, triangle, u, v, _TIME)
        if dot(ng, direction) < 0.0:
            is_closed, meets_front = False, True
    return is_closed, meets_front


@kernel
def _is_seen(scene, geometry, ray, bits, address, p, ng, is_alike, start):
    """Whether somebody may see two faces in one place; `is_alike`: they face the same way."""
    along = (np.float32(1.0), np.float32(0.0), np.float32(0.0))
    if abs(ng[0]) > np.float32(0.6):
        along = (np.float32(0.0), np.float32(1.0), np.float32(0.0))
    along = normalize(cross(ng, along))
    front_closed, front_sees = _looks_closed(
        scene, geometry, ray, bits, address, add(p, scale(ng, start)), ng, along
    )
    back = scale(ng, np.float32(-1.0))
    back_closed, back_sees = _looks_closed(
        scene, geometry, ray, bits, address, add(p, scale(back, start)), back, along
    )
    if is_alike:
        return not (front_closed and back_closed)
    # A box on a plane is closed above the plane, and under it there is often nothing.
    return front_sees or back_sees or not (front_closed or back_closed)


@kernel
def _find_coincident(scene, geometry, ray, bits, address, instances, triangles, rows, points, found):
    """Write which instances, bool (I,), have faces in one place with others."""
    for k in range(instances.shape[0]):
        instance, triangle = instances[k], triangles[k]
        u, v = points[rows[k], 0], points[rows[k], 1]
        p, ng, _ns, error = surface_point(geometry, instance, triangle, u, v, _TIME)
        # Written so that what is no number, or nowhere, has no place.
        if not (dot(ng, ng) > np.float32(0.5) and error < np.float32(np.inf)):
            continue
        reach = error * np.float32(2.0)
        start_on(bits, geometry, instance, triangle)
        if not trace_closest_from(
            scene, ray, bits, address, add(p, scale(ng, reach)), scale(ng, np.float32(-1.0)), np.float32(0.0),
            reach * np.float32(2.0), _TIME, NONE,
        ):
            continue
        other, beside, _distance, u, v = read_hit(ray, bits, geometry)
        if found[instance] and found[other]:
            continue
        if geometry.mesh_table[geometry.instance_table[other, INSTANCE_MESH], MESH_SHAPE] != SHAPE_TRIANGLES:
            continue
        _p, normal, _ns, _error = surface_point(geometry, other, beside, u, v, _TIME)
        cosine = dot(ng, normal)
        if abs(cosine) > _PARALLEL and _is_seen(
            scene, geometry, ray, bits, address, p, ng, cosine > 0.0, np.float32(REACH) * error
        ):
            found[instance] = True
            found[other] = True


def find_coincident(
    geometry: GeometryArrays, accelerator: Accelerator, check_cancel: Callable[[], None]
) -> npt.NDArray[np.bool_]:
    """Instances with faces that lie in one place with others, of their own or of another instance: bool (I,).

    Of meshes with many triangles some points are looked at, so that small faces may go unseen.

    Parameters
    ----------
    accelerator : Accelerator
        Of this geometry; it does not matter where rays start in place.
    """
    found = np.zeros(len(geometry.instance_table), np.bool_)
    instances, triangles, rows = _points_of(geometry)
    if len(instances):
        check_cancel()
        scratch = RayScratch()
        _find_coincident(
            accelerator.handle, geometry, scratch.ray, scratch.bits, scratch.address, instances, triangles, rows,
            _POINTS, found,
        )
    return found
