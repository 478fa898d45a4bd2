# SPDX-License-Identifier: GPL-3.0-or-later
"""Places of a bake as arrays: which pixels have some, where they are, and what cannot be baked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.builder.bake import build_bake
from engine.builder.geometry import build_geometry
from engine.scene.bake import BAND_TEXELS, FROM_CAMERA, Bake, bands_of
from engine.scene.description import Camera, Frame, Mesh, SceneDescription
from engine.scene.instances import plain_instances
from engine.state.bake import (
    BAKE_DISTANCE,
    BAKE_EYE,
    BAKE_FIRST_ROW,
    BAKE_VIEW,
    PLACE_RADIUS,
    VIEW_DIRECTION,
    VIEW_POINT,
    BakeArrays,
)


def square(**changes: Any) -> SceneDescription:
    """A mesh that is not baked, and a square of side 2 of whose 2 x 1 pixels one is baked."""
    corners = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)], np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    meshes = [Mesh(name, name, corners, triangles, None, np.zeros(2, np.int32)) for name in ("Other", "Square")]
    bake = Bake(
        instance=1,
        triangles=np.array([[-1, 1]], np.int32),
        weights=np.full((1, 2, 2), 0.25, np.float32),
        differentials=np.tile(np.array([0.5, 0.0, 0.0, 0.25], np.float32), (1, 2, 1)),
    )
    return SceneDescription(
        camera=Camera(),
        frame=Frame(2, 1, (0, 0, 2, 1)),
        meshes=meshes,
        instances=replace(
            plain_instances(np.stack([np.eye(4), np.diag([2.0, 2.0, 2.0, 1.0])]), meshes=[0, 1]),
            name=["Other", "Square"],
        ),
        materials=[], images=[], lights=[], world=None,
        bake=replace(bake, **changes),
    )  # fmt: skip


def built(description: SceneDescription) -> BakeArrays:
    return build_bake(description, build_geometry(description, (), []))


def test_pixels_know_their_places() -> None:
    bake = built(square())
    assert bake.rows.tolist() == [-1, 0]
    assert bake.triangles.tolist() == [3]
    assert bake.places[0, :6].tolist() == [0.25, 0.25, 0.5, 0.0, 0.0, 0.25]
    # By x half of the edge from the third corner to the first, by y a quarter of that to the second.
    along_x = 0.5 * np.linalg.norm([0.0, -2.0])
    along_y = 0.25 * np.linalg.norm([2.0, 0.0])
    assert np.isclose(bake.places[0, PLACE_RADIUS], 0.5 * (along_x + along_y))
    assert np.isclose(bake.numbers[BAKE_DISTANCE], 2.0 * np.sqrt(2.0))


def test_places_of_some_rows_are_those_of_the_whole_image() -> None:
    """The third of five rows, with others that are there for the denoiser."""
    description = square(first_row=1, triangles=np.array([[-1, -1], [-1, 1], [1, -1]], np.int32),
                         weights=np.full((3, 2, 2), 0.25, np.float32), differentials=np.zeros((3, 2, 4), np.float32))
    bake = built(replace(description, frame=Frame(2, 5, (0, 2, 2, 3))))
    assert bake.rows.tolist() == [-1, -1, -1, 0, 1, -1] and bake.header[BAKE_FIRST_ROW] == 1
    assert description.bake is not None and description.bake.region == (0, 2, 2, 4)


def test_large_images_are_baked_in_bands_that_have_every_row_once() -> None:
    assert bands_of(4096, 4096) == [(0, 4096)]
    for width, height in ((8192, 8192), (16384, 16384), (5000, 3500), (1 << 25, 3)):
        bands = bands_of(width, height)
        assert len(bands) > 1
        assert [row for first, end in bands for row in range(first, end)] == list(range(height))
        assert all(width * (end - first) <= max(BAND_TEXELS, width) for first, end in bands)


def test_without_a_bake_there_are_no_places() -> None:
    assert not len(built(replace(square(), bake=None)).rows)


def test_places_at_corners_are_moved_inwards() -> None:
    weights = np.array([[(0.0, 0.0), (1.0, 0.0)]], np.float32)
    (u, v), *_ = built(square(weights=weights)).places[:, :2].tolist()
    assert 0.9998 < u < 1.0 and 0.0 < v < 2e-4 and 1.0 - u - v > 0.0


@pytest.mark.parametrize(
    ("kind", "view", "eye"), [("PERSP", VIEW_POINT, (3.0, 4.0, 5.0)), ("ORTHO", VIEW_DIRECTION, (0.0, 0.0, 1.0))]
)
def test_places_are_seen_from_the_camera(kind: str, view: int, eye: tuple[float, ...]) -> None:
    transform = np.eye(4, dtype=np.float32)
    transform[:3, 3] = (3.0, 4.0, 5.0)
    bake = built(replace(square(view=FROM_CAMERA), camera=Camera(kind=kind, transform=transform)))
    assert bake.header[BAKE_VIEW] == view
    assert bake.numbers[BAKE_EYE : BAKE_EYE + 3].tolist() == list(eye)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"triangles": np.zeros((2, 2), np.int32)}, "2 x 2 pixels from row 0 on, and the image is 2 x 1"),
        ({"first_row": 1}, "2 x 1 pixels from row 1 on, and the image is 2 x 1"),
        ({"instance": 2}, "of instance 2, and there are 2"),
        ({"triangles": np.array([[0, 2]], np.int32)}, "'Square' has 2 triangles, and triangle 2 is to be baked"),
        ({"view": "BELOW"}, "view is 'BELOW': choose ABOVE"),
    ],
)
def test_what_cannot_be_baked_is_refused_in_words(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        built(square(**changes))


def test_meshes_with_broken_faces_are_refused_in_words() -> None:
    """Those are left out of the arrays, so that triangles would be others."""
    description = square()
    description.meshes[1].vertices[3] = np.nan
    with pytest.raises(ValueError, match="'Square' has faces with vertices that are NaN"):
        built(description)
