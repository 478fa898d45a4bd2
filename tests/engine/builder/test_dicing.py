# SPDX-License-Identifier: GPL-3.0-or-later
"""Meshes divided until their edges are short: no cracks, the same surface, attributes in place."""

from __future__ import annotations

import itertools

import numpy as np
import pytest

from engine.builder import dicing
from engine.scene.attribute_names import VERTEX_NORMALS
from engine.scene.description import Attribute, Mesh
from engine.scene.dicing import Dicing

NO_SIDES = np.zeros((0, 4))


def plane() -> Mesh:
    """A square of four triangles about the origin, 8 long, with a UV map."""
    vertices = np.array([[-4, -4, 0], [4, -4, 0], [4, 4, 0], [-4, 4, 0], [0, 0, 0]], np.float32)
    triangles = np.array([[0, 1, 4], [1, 2, 4], [2, 3, 4], [3, 0, 4]], np.uint32)
    uv = (vertices[triangles.reshape(-1), :2] + 4.0) / 8.0
    attributes = {
        "UV": Attribute("CORNER", uv.astype(np.float32)),
        VERTEX_NORMALS: Attribute("POINT", np.tile(np.array([[0, 0, 1]], np.float32), (5, 1))),
        "Face": Attribute("FACE", np.arange(4, dtype=np.float32)[:, None]),
    }
    normals = np.tile(np.array([0, 0, 1], np.float32), (4, 3, 1))
    slots = np.array([0, 1, 0, 1], np.int32)
    return Mesh("plane", "plane", vertices, triangles, normals, slots, attributes, "UV")


def by_length(length: float, level: int = 12) -> Dicing:
    return Dicing(level, np.eye(3, 4), length, 0.0, NO_SIDES, 0.0)


def by_view(growth: float, level: int = 12) -> Dicing:
    """From a camera at (0, -3, 0.5), whose space is that of the object but for its place."""
    to_space = np.eye(3, 4)
    to_space[:, 3] = (0.0, 3.0, -0.5)
    return Dicing(level, to_space, 0.0, growth, NO_SIDES, 0.0)


def edges_of(mesh: Mesh) -> np.ndarray:
    """Ends of all edges of all triangles, in order, (3 * T, 2)."""
    return np.sort(np.concatenate([mesh.triangles[:, [a, b]] for a, b in ((0, 1), (1, 2), (2, 0))]), axis=1)


def area(mesh: Mesh) -> np.ndarray:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]].astype(np.float64) for k in range(3))
    return 0.5 * np.cross(b - a, c - a)[:, 2]


@pytest.mark.parametrize("how", [by_length(0.7), by_view(0.06)], ids=["length", "view"])
def test_there_are_no_cracks_and_no_folds(how: Dicing) -> None:
    diced = dicing.diced(plane(), how)
    assert len(diced.triangles) > 200
    _, counts = np.unique(edges_of(diced), axis=0, return_counts=True)
    outline = np.unique(edges_of(diced), axis=0)[counts == 1]
    assert counts.max() == 2
    # What has a triangle on one side alone is the square's rim: a crack would be elsewhere.
    assert (np.abs(diced.vertices[outline]).max(axis=2) == 4.0).all()
    assert (area(diced) > 0.0).all()
    assert np.isclose(area(diced).sum(), 64.0, rtol=1e-5)
    assert len(np.unique(diced.vertices, axis=0)) == len(diced.vertices)


def test_edges_are_short_enough_everywhere() -> None:
    how = by_view(0.06)
    diced = dicing.diced(plane(), how)
    ends = diced.vertices[edges_of(diced)] @ how.to_space[:, :3].T + how.to_space[:, 3]
    lengths = np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1)
    allowed = how.lengths_at(ends.mean(axis=1))
    assert (lengths <= 1.8 * allowed).all()
    # And hardly any is much shorter than it need be.
    assert np.median(lengths / allowed) > 0.8


def test_attributes_are_where_they_were() -> None:
    diced = dicing.diced(plane(), by_length(0.9))
    places = diced.vertices[diced.triangles.reshape(-1)]
    assert np.allclose(diced.attributes["UV"].data, (places[:, :2] + 4.0) / 8.0, atol=1e-6)
    assert np.allclose(diced.attributes[VERTEX_NORMALS].data, (0, 0, 1))
    centers = diced.vertices[diced.triangles].mean(axis=1)
    face = np.select([centers[:, 1] < -np.abs(centers[:, 0]), centers[:, 0] > np.abs(centers[:, 1]),
                      centers[:, 1] > np.abs(centers[:, 0])], [0, 1, 2], 3)  # fmt: skip
    assert np.array_equal(diced.attributes["Face"].data[:, 0], face)
    assert np.array_equal(diced.material_slots, face % 2)
    assert diced.corner_normals is not None and diced.corner_normals.shape == (len(diced.triangles), 3, 3)


def test_the_number_is_known_beforehand() -> None:
    for how in (by_length(0.3), by_length(0.1), by_view(0.03), by_view(0.008)):
        count = len(dicing.diced(plane(), how).triangles)
        assert 0.7 * count < dicing.estimated_count(plane(), how) < 2.0 * count
    assert len(dicing.diced(plane(), by_length(1e-6, level=3)).triangles) == 4**4
    assert dicing.estimated_count(plane(), by_length(1e-6, level=3)) == 4**4


def test_too_many_are_refused_with_their_number() -> None:
    fine = plane()
    fine.dicing = by_length(1e-6, level=20)
    with pytest.raises(ValueError, match=r"mesh plane, diced .* would be about 4,\d{3},\d{3},\d{3},\d{3} triangles"):
        dicing.dice(fine, fine.dicing)


def test_triangles_that_reach_the_camera_are_not_refused() -> None:
    """Their number goes by all of them, not by where they are finest."""
    wide = plane()
    wide.vertices *= np.float32(1000.0)
    how = by_view(0.02, level=11)
    count = len(dicing.diced(wide, how).triangles)
    assert 0.5 * count < dicing.estimated_count(wide, how) < 3.0 * count


def test_objects_that_share_an_edge_share_its_vertices() -> None:
    """Each has its own space; what counts is where the edge is."""
    left, right = plane(), plane()
    right.vertices[:, 0] += np.float32(3.0)
    seen = by_view(0.06)
    moved = by_view(0.06)
    # The right one stands 5 to the right of where its mesh is: 8 from the left one.
    moved.to_space[:, 3] += (5.0, 0.0, 0.0)
    ends = []
    for mesh, how, edge in ((left, seen, 4.0), (right, moved, -1.0)):
        made = dicing.diced(mesh, how).vertices
        ends.append(np.sort(made[np.isclose(made[:, 0], edge)][:, 1]))
    assert len(ends[0]) > 20
    assert np.array_equal(ends[0], ends[1])


def test_motion_is_divided_alike() -> None:
    moving = plane()
    moving.motion_vertices = np.stack([moving.vertices, moving.vertices + np.float32(1.0)])
    assert moving.corner_normals is not None
    moving.motion_normals = np.stack([moving.corner_normals] * 2)
    diced = dicing.diced(moving, by_length(1.5))
    assert diced.motion_vertices is not None and diced.motion_normals is not None
    assert np.allclose(diced.motion_vertices, [diced.vertices, diced.vertices + 1.0], atol=1e-6)
    assert diced.motion_normals.shape == (2, len(diced.triangles), 3, 3)


def test_order_of_triangles_and_their_corners_does_not_matter() -> None:
    """Every way in which a triangle's edges may be long."""
    for shape in itertools.product((1.0, 2.9), repeat=3):
        corners = np.array([[0, 0, 0], [shape[0], 0, 0], [0.3, shape[1], shape[2] - 1.0]], np.float32)
        for turn in range(3):
            one = Mesh("t", "t", np.roll(corners, turn, axis=0), np.array([[0, 1, 2]], np.uint32), None,
                       np.zeros(1, np.int32))  # fmt: skip
            made = dicing.diced(one, by_length(0.8))
            a, b, c = (made.vertices[made.triangles[:, k]].astype(np.float64) for k in range(3))
            whole = 0.5 * np.linalg.norm(np.cross(corners[1] - corners[0], corners[2] - corners[0]))
            assert np.isclose(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1).sum(), whole, rtol=1e-5)
