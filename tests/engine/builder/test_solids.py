# SPDX-License-Identifier: GPL-3.0-or-later
"""Which meshes enclose a space: closed ones, however their vertices are shared, and whichever way they face."""

from __future__ import annotations

import numpy as np
import pytest

from engine.builder.solids import mark_solids
from engine.state.geometry import MESH_SOLID, MESH_TRIANGLE_COUNT, MESH_WIDTH

#: Of a box: corners, and triangles whose fronts are outside.
CORNERS = np.array([(x, y, z) for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float32)
BOX = np.array(
    [(0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1), (2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4),
     (1, 5, 7), (1, 7, 3)], np.uint32,
)  # fmt: skip


def is_solid(vertices, triangles):
    table = np.zeros((1, MESH_WIDTH), np.int32)
    table[0, MESH_TRIANGLE_COUNT] = len(triangles)
    mark_solids(table, np.ascontiguousarray(vertices, np.float32), np.ascontiguousarray(triangles, np.uint32))
    return bool(table[0, MESH_SOLID])


def turned(vertices):
    rotation, _ = np.linalg.qr(np.random.default_rng(3).normal(size=(3, 3)))
    return vertices @ rotation.T


@pytest.mark.parametrize("size", [(1.0, 1.0, 1.0), (20.0, 30.0, 0.01)])
@pytest.mark.parametrize("place", [0.0, 300.0])
def test_boxes_enclose_a_space_wherever_they_are(size, place):
    vertices = turned(CORNERS * size) + place
    assert is_solid(vertices, BOX)
    assert is_solid(vertices, BOX[:, ::-1])
    # Faces with vertices of their own, as many files have them.
    assert is_solid(vertices[BOX.ravel()], np.arange(BOX.size).reshape(-1, 3))


def test_a_box_within_a_box_encloses_what_is_between():
    inner = 0.25 + 0.5 * CORNERS
    assert is_solid(np.concatenate([CORNERS, inner]), np.concatenate([BOX, BOX[:, ::-1] + 8]))


@pytest.mark.parametrize("missing", [slice(0, 1), slice(0, 2), slice(0, 4), slice(0, 10)])
def test_what_is_open_encloses_nothing(missing):
    """Without a triangle, a side, or two sides that are opposite: a tube has no sum of normals either."""
    assert not is_solid(turned(CORNERS), np.delete(BOX, missing, axis=0))


def test_two_layers_without_a_rim_enclose_nothing():
    sheets = np.concatenate([BOX[0:2], BOX[2:4]])
    assert not is_solid(turned(CORNERS * (0.01, 1.0, 1.0)), sheets)
    flat = np.concatenate([BOX[0:2], BOX[0:2, ::-1]])
    assert not is_solid(turned(CORNERS), flat)


def test_nothing_and_triangles_without_an_area_enclose_nothing():
    assert not is_solid(CORNERS, BOX[:0])
    assert not is_solid(CORNERS * 0.0, BOX)
