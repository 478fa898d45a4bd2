# SPDX-License-Identifier: GPL-3.0-or-later
"""The places of a bake as the arrays that `wavefront.baked_rays` reads."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.scene.bake import BACKGROUND, FROM_ABOVE, FROM_CAMERA, Bake
from engine.scene.description import Camera, SceneDescription
from engine.state.bake import (
    BAKE_DISTANCE,
    BAKE_EYE,
    BAKE_FIRST_ROW,
    BAKE_HEADER_WIDTH,
    BAKE_IMAGE_WIDTH,
    BAKE_INSTANCE,
    BAKE_NUMBERS,
    BAKE_VIEW,
    PLACE_RADIUS,
    PLACE_WIDTH,
    VIEW_ABOVE,
    VIEW_BACKGROUND,
    VIEW_DIRECTION,
    VIEW_POINT,
    BakeArrays,
    no_bake,
)
from engine.state.geometry import MESH_FIRST_TRIANGLE, MESH_SHAPE, MESH_TRIANGLE_COUNT, SHAPE_TRIANGLES, GeometryArrays

#: How far from a corner a place that is exactly there is moved towards the triangle's middle: a share of the largest
#: coordinate, or of 1 m if that is more. Shadow rays would leave along the faces beside it. As in Cycles.
_OFF_CORNERS = 1e-4

#: Places whose corners are looked up together: those of all take ten times as much room as the places.
_BLOCK = 1 << 18


def build_bake(description: SceneDescription, geometry: GeometryArrays) -> BakeArrays:
    """The places that a description's bake looks at; those of nobody where it has none.

    Raises
    ------
    ValueError
        If a place is on no triangle that is there, or pixels and places are not as many.
    """
    bake = description.bake
    if bake is None:
        return no_bake()
    frame, instances = description.frame, description.instances
    row_count, column_count = bake.triangles.shape
    _, bottom, _, top = frame.region
    is_there = 0 <= bake.first_row <= bottom and top <= bake.first_row + row_count <= frame.height
    if column_count != frame.width or not is_there:
        raise ValueError(
            f"the bake has places for {column_count} x {row_count} pixels from row {bake.first_row} on, and the image "
            f"is {frame.width} x {frame.height}"
        )
    if not 0 <= bake.instance < len(instances.mesh):
        raise ValueError(f"the bake is of instance {bake.instance}, and there are {len(instances.mesh)}")
    mesh_number = int(instances.mesh[bake.instance])
    mesh, row = description.meshes[mesh_number], geometry.mesh_table[mesh_number]
    name = instances.name[bake.instance]
    if row[MESH_SHAPE] != SHAPE_TRIANGLES:
        raise ValueError(f"object {name!r} has no faces: only meshes can be baked")
    if row[MESH_TRIANGLE_COUNT] != len(mesh.triangles):
        raise ValueError(
            f"object {name!r} has faces with vertices that are NaN, infinite or missing, or is divided further for its "
            f"displacement: its faces are others than those to be baked. Repair the mesh, or bake without adaptive "
            f"subdivision"
        )
    is_covered = bake.triangles >= 0
    triangles = bake.triangles[is_covered]
    if len(triangles) and int(triangles.max()) >= len(mesh.triangles):
        raise ValueError(
            f"object {name!r} has {len(mesh.triangles)} triangles, and triangle {int(triangles.max())} is to be baked: "
            f"its mesh is another in the bake than in renders"
        )
    rows = np.full(is_covered.size, -1, np.int32)
    rows[is_covered.reshape(-1)] = np.arange(len(triangles), dtype=np.int32)
    places = np.empty((len(triangles), PLACE_WIDTH), np.float32)
    places[:, :2], places[:, 2:6] = bake.weights[is_covered], bake.differentials[is_covered]
    transform = np.asarray(instances.transform[bake.instance], np.float64)
    for start in range(0, len(places), _BLOCK):
        block = places[start : start + _BLOCK]
        corners = np.asarray(mesh.vertices, np.float64)[mesh.triangles[triangles[start : start + _BLOCK]]]
        block[:, :2] = _off_corners(block[:, :2].astype(np.float64), corners)
        block[:, PLACE_RADIUS] = _radii(block[:, 2:6].astype(np.float64), corners, transform)
    header = np.zeros(BAKE_HEADER_WIDTH, np.int64)
    header[BAKE_INSTANCE], header[BAKE_IMAGE_WIDTH] = bake.instance, frame.width
    header[BAKE_FIRST_ROW] = bake.first_row
    numbers = np.zeros(BAKE_NUMBERS, np.float32)
    header[BAKE_VIEW], numbers[BAKE_EYE : BAKE_EYE + 3] = _view(bake, description.camera)
    numbers[BAKE_DISTANCE] = _extent(np.asarray(mesh.vertices, np.float64), transform)
    seeds = np.zeros(0, np.int32) if bake.seeds is None else bake.seeds[is_covered].astype(np.int32)
    return BakeArrays(
        header, numbers, rows, places, triangles + np.int32(row[MESH_FIRST_TRIANGLE]), seeds
    )


def _view(bake: Bake, camera: Camera) -> tuple[int, npt.NDArray[np.float64]]:
    """From where places are seen: VIEW_*, and BAKE_EYE."""
    transform = np.asarray(camera.transform, np.float64)
    if bake.view == FROM_ABOVE:
        return VIEW_ABOVE, np.zeros(3)
    if bake.view == BACKGROUND:
        return VIEW_BACKGROUND, np.zeros(3)
    if bake.view != FROM_CAMERA:
        raise ValueError(f"a bake's view is {bake.view!r}: choose ABOVE, CAMERA or BACKGROUND")
    if camera.kind == "ORTHO":
        return VIEW_DIRECTION, transform[:3, 2] / np.linalg.norm(transform[:3, 2])
    return VIEW_POINT, transform[:3, 3]


def _off_corners(weights: npt.NDArray[np.float64], corners: npt.NDArray[np.float64]) -> npt.NDArray[np.float64]:
    """Weights (R, 2), of places at a corner moved towards the middle of the triangle; corners are (R, 3, 3)."""
    at_corner = np.isin(weights, (0.0, 1.0)).all(axis=1)
    moved, of = weights[at_corner], corners[at_corner]
    whole = np.concatenate([moved, 1.0 - moved.sum(axis=1, keepdims=True)], axis=1)
    p = np.einsum("rc,rck->rk", whole, of)
    away = np.linalg.norm(of.mean(axis=1) - p, axis=1)
    step = np.maximum(np.abs(p).max(axis=1, initial=0.0), 1.0) * _OFF_CORNERS
    share = np.minimum(step / np.maximum(away, 1e-30), 1.0)[:, None]
    result = weights.copy()
    result[at_corner] = moved + share * (1.0 / 3.0 - moved)
    return result


def _radii(
    differentials: npt.NDArray[np.float64], corners: npt.NDArray[np.float64], transform: npt.NDArray[np.float64]
) -> npt.NDArray[np.float64]:
    """Half the mean edge of each pixel on the surface, by x and y, as Cycles makes a compact differential [m]."""
    edges = (corners[:, :2] - corners[:, 2:]) @ transform[:3, :3].T
    along = np.einsum("rec,rek->rck", differentials.reshape(-1, 2, 2), edges)
    result: npt.NDArray[np.float64] = 0.5 * np.linalg.norm(along, axis=2).sum(axis=1)
    return result


def _extent(vertices: npt.NDArray[np.float64], transform: npt.NDArray[np.float64]) -> float:
    """Diagonal of a mesh's box in the world [m]."""
    corners = np.stack([vertices.min(axis=0), vertices.max(axis=0)])
    return float(np.linalg.norm(np.abs(transform[:3, :3]) @ (corners[1] - corners[0])))
