# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves and spheres in Embree: how control points are numbered, what rays meet, and what they skip."""

from __future__ import annotations

import numpy as np
import pytest

from engine.accel.accelerator import build_accelerator
from engine.accel.hierarchies import MeshHierarchies
from engine.accel.rays import trace_closest, trace_closest_from
from engine.accel.rounds import control_points
from engine.accel.scratch import RayScratch
from engine.accel.skipped_triangles import start_on
from engine.builder.geometry import build_geometry
from engine.builder.rounds import is_uniform
from engine.kernels.rounds import radius_at
from engine.runtime.jit import kernel
from engine.scene.description import Mesh, Notice
from engine.scene.rounds import RIBBONS, ROUND, ROUND_LINEAR, SPHERES, Rounds
from tests.helpers.placed_quads import at, quad_scene


@kernel
def _distance(scene, ray, bits, address, x, y):
    direction = (0.0, 0.0, -1.0)
    far = np.float32(np.inf)
    return ray[8] if trace_closest(scene, ray, bits, address, (x, y, 5.0), direction, 0.0, far, 0.0, 31) else far


@kernel
def _distance_at(scene, ray, bits, address, x, y, time):
    direction = (0.0, 0.0, -1.0)
    far = np.float32(np.inf)
    return ray[8] if trace_closest(scene, ray, bits, address, (x, y, 5.0), direction, 0.0, far, time, 31) else far


@kernel
def _distance_from(scene, geometry, ray, bits, address, x, y, row):
    direction = (0.0, 0.0, -1.0)
    far = np.float32(np.inf)
    start_on(bits, geometry, 0, row)
    return ray[8] if trace_closest_from(scene, ray, bits, address, (x, y, 5.0), direction, 0.0, far, 0.0, 31) else far


def _mesh(shape, radius=0.1):
    """Two strands along x, at y = 0 and 1, of three keys each; or a sphere at each of their keys."""
    x = np.array([0.0, 1.0, 2.0])
    vertices = np.array([(k, y, 0.0) for y in (0.0, 1.0) for k in x], np.float32)
    rows = np.array([(0, 1, 0), (1, 2, 0), (3, 4, 3), (4, 5, 3)], np.uint32)
    if shape == SPHERES:
        rows = np.repeat(np.arange(6, dtype=np.uint32)[:, None], 3, axis=1)
    rounds = Rounds(shape, np.full(6, radius, np.float32))
    return Mesh(shape, shape, vertices, rows, None, np.zeros(len(rows), np.int32), rounds=rounds)


def _built(mesh, transform=None):
    description = quad_scene([at(0.0, 0.0, 0.0) if transform is None else transform])
    description.meshes = [mesh]
    notices: list[Notice] = []
    geometry = build_geometry(description, (), notices)
    accelerator = build_accelerator(geometry, np.zeros(1, np.uint32), MeshHierarchies())
    return geometry, accelerator, RayScratch(), notices


def _traced(built, x, y):
    _geometry, accelerator, scratch, _notices = built
    return _distance(accelerator.handle, scratch.ray, scratch.bits, scratch.address, x, y)


def test_control_points_continue_through_a_curve_and_end_twice() -> None:
    rows = np.array([(0, 1, 0), (1, 2, 0), (3, 4, 3)], np.uint32)
    firsts, vertices = control_points(rows, 1)
    assert firsts.tolist() == [0, 1, 5] and vertices.tolist() == [0, 0, 1, 2, 2, 3, 3, 4, 4]
    firsts, vertices = control_points(rows, 0)
    assert firsts.tolist() == [0, 1, 3] and vertices.tolist() == [0, 1, 2, 3, 4]


def test_a_lost_segment_ends_a_run() -> None:
    rows = np.array([(0, 1, 0), (2, 3, 0)], np.uint32)
    firsts, vertices = control_points(rows, 0)
    assert firsts.tolist() == [0, 2] and vertices.tolist() == [0, 1, 2, 3]


@pytest.mark.parametrize(("shape", "top"), [(RIBBONS, 0.0), (ROUND, 0.1), (ROUND_LINEAR, 0.1)])
def test_rays_meet_curves_where_they_are(shape, top) -> None:
    built = _built(_mesh(shape))
    assert _traced(built, 0.5, 0.0) == pytest.approx(5.0 - top, abs=1e-3)
    assert _traced(built, 1.5, 1.0) == pytest.approx(5.0 - top, abs=1e-3)
    assert np.isinf(_traced(built, 0.5, 0.5)) and np.isinf(_traced(built, 0.5, 0.12))


def test_rays_meet_spheres_and_radii_grow_with_the_object() -> None:
    built = _built(_mesh(SPHERES), at(0.0, 0.0, 0.0, (2.0, 2.0, 2.0)))
    assert _traced(built, 2.0, 0.0) == pytest.approx(5.0 - 0.2, abs=1e-5)
    assert np.isinf(_traced(built, 1.0, 0.0))


@pytest.mark.parametrize("shape", [ROUND, ROUND_LINEAR, SPHERES])
@pytest.mark.parametrize("is_placed", [True, False])
def test_rays_meet_what_changes_its_shape_where_it_is_at_their_time(shape: str, is_placed: bool) -> None:
    """It rises by 1 m, and its radius of 0.1 m doubles; twice as large where the object is."""
    mesh = _mesh(shape)
    assert mesh.rounds is not None
    mesh.motion_vertices = mesh.vertices + np.array([0.0, 0.5, 1.0], np.float32)[:, None, None] * (0.0, 0.0, 1.0)
    mesh.rounds.motion_radii = np.repeat(np.float32([[0.1], [0.15], [0.2]]), 6, axis=1)
    size = 2.0 if is_placed else 1.0
    place = at(0.0, 0.0, 0.0, (size, size, size if is_placed else 1.0 + 1e-3))
    geometry, accelerator, scratch, _notices = _built(mesh, place)
    for time in (0.0, 0.25, 1.0):
        found = _distance_at(accelerator.handle, scratch.ray, scratch.bits, scratch.address, size, 0.0, time)
        assert found == pytest.approx(5.0 - size * (time + 0.1 * (1.0 + time)), abs=5e-3)
        told = radius_at(geometry, 0, 0, 1.0, time)
        # Of spheres that at the middle, as in Cycles.
        assert told == pytest.approx(size * (0.1 if shape == SPHERES else 0.1 * (1.0 + time)), rel=1e-3)


def test_radii_stay_where_steps_have_none() -> None:
    mesh = _mesh(ROUND)
    mesh.motion_vertices = np.stack([mesh.vertices, mesh.vertices + np.float32(1.0)])
    geometry, accelerator, scratch, _notices = _built(mesh)
    found = _distance_at(accelerator.handle, scratch.ray, scratch.bits, scratch.address, 2.0, 1.0, 1.0)
    assert found == pytest.approx(5.0 - 1.1, abs=1e-3)
    assert radius_at(geometry, 0, 0, 0.5, 1.0) == pytest.approx(0.1)


def test_rays_skip_all_of_the_curve_that_they_start_on() -> None:
    geometry, accelerator, scratch, _notices = _built(_mesh(ROUND))
    memory = scratch.ray, scratch.bits, scratch.address
    assert np.isinf(_distance_from(accelerator.handle, geometry, *memory, 1.5, 0.0, 0))
    assert not np.isinf(_distance_from(accelerator.handle, geometry, *memory, 1.5, 1.0, 0))


def test_what_is_no_number_is_left_out_and_named() -> None:
    mesh = _mesh(ROUND)
    mesh.vertices[4] = np.nan
    mesh.rounds.radii[0] = -1.0
    built = _built(mesh)
    assert np.isinf(_traced(built, 0.5, 1.0)) and not np.isinf(_traced(built, 1.5, 0.0))
    problems = " ".join(notice.problem for notice in built[3])
    assert "NaN" in problems and "radii are negative" in problems


@pytest.mark.parametrize("shape", [ROUND_LINEAR, SPHERES])
def test_what_is_stretched_is_no_longer_round(shape: str) -> None:
    """A radius of 0.1 m is 0.2 m along y and 0.1 m along z where y is stretched twice."""
    stretched = np.diag([1.0, 2.0, 1.0, 1.0]).astype(np.float32)
    built = _built(_mesh(shape), stretched)
    assert _traced(built, 1.0, 0.19) < np.inf and _traced(built, 1.0, 0.21) == np.inf
    assert _traced(built, 1.0, 0.0) == pytest.approx(4.9, abs=1e-4)


def test_curves_that_keep_their_shape_are_stored_in_the_world() -> None:
    turned = 2.0 * np.array([[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    assert is_uniform(turned) and not is_uniform(np.diag([1.0, 1.3, 0.9]))


@pytest.mark.parametrize("shape", [RIBBONS, ROUND, ROUND_LINEAR, SPHERES])
@pytest.mark.parametrize("radius", [0.0, 1e-6, 3.0])
def test_radii_of_any_size_are_met_at_a_distance_or_not_at_all(shape: str, radius: float) -> None:
    built = _built(_mesh(shape, radius))
    found = [_traced(built, x, y) for x in np.linspace(-0.5, 2.5, 13) for y in (0.0, 1e-7, 0.5, 1.0)]
    assert not np.isnan(found).any() and all(value > 0.0 for value in found)
    if radius == 0.0:
        # Embree finds straight ones up to a rounding beside their axis.
        assert np.isinf([_traced(built, x, 0.01) for x in np.linspace(-0.5, 2.5, 13)]).all()
    if radius == 3.0 and shape != RIBBONS:
        # Embree lets rays start within two radii of a ribbon.
        assert _traced(built, 1.0, 0.5) == pytest.approx(2.0, abs=0.1)


@pytest.mark.parametrize("shape", [RIBBONS, ROUND, ROUND_LINEAR])
def test_a_strand_of_no_length_leaves_others_as_they_are(shape: str) -> None:
    mesh = _mesh(shape)
    mesh.vertices[3:] = mesh.vertices[3]
    built = _built(mesh)
    assert np.isfinite(_traced(built, 0.5, 0.0))
    assert not np.isnan([_traced(built, x, 1.0) for x in (-0.05, 0.0, 0.05, 1.0)]).any()
    assert np.isinf(_traced(built, 1.0, 1.0))
