# SPDX-License-Identifier: GPL-3.0-or-later
"""Panoramas: every kind's mapping and its inverse, and the eyes of spherical stereo."""

import math

import numpy as np
import pytest

from engine.builder.camera import build_camera
from engine.kernels.camera import generate_ray
from engine.kernels.panorama import panorama_direction, panorama_position, panorama_window
from engine.kernels.vector import normalize
from engine.runtime.jit import kernel
from engine.scene.description import Camera, Frame
from engine.scene.panorama import Panorama, StereoEye
from engine.state.camera import CAMERA_OFFSET_X, CAMERA_OFFSET_Y, CAMERA_SCALE_X, CAMERA_SCALE_Y

SQUARE = Frame(64, 64, (0, 0, 64, 64))
KINDS = [
    Panorama("EQUIRECTANGULAR", latitude_min=-0.5, longitude_max=1.0),
    Panorama("EQUIANGULAR_CUBEMAP_FACE"),
    Panorama("MIRRORBALL"),
    Panorama("FISHEYE_EQUIDISTANT", fisheye_fov=3.8),
    Panorama("FISHEYE_EQUISOLID", fisheye_lens=10.5, fisheye_fov=3.2, sensor=(36.0, 24.0)),
    Panorama("FISHEYE_LENS_POLYNOMIAL", polynomial=(0.0, -0.09, 1e-3, -2e-5, 0.0), sensor=(36.0, 24.0)),
    Panorama("CENTRAL_CYLINDRICAL", cylinder=(-2.0, 2.5, -1.0, 1.5)),
]


@kernel
def _there_and_back(camera, xy, directions, back, window):
    for i in range(xy.shape[0]):
        d = panorama_direction(camera, xy[i, 0], xy[i, 1])
        if d[0] != 0.0 or d[1] != 0.0 or d[2] != 0.0:
            d = normalize(d)
            back[i, 0], back[i, 1] = panorama_position(camera, d)
            window[i, 0], window[i, 1] = panorama_window(camera, d)
        for c in range(3):
            directions[i, c] = d[c]


@kernel
def _rays(camera, motion, xy, lens, rays):
    for i in range(xy.shape[0]):
        o, d, _, _, _, spread = generate_ray(camera, motion, xy[i, 0], xy[i, 1], lens[i, 0], lens[i, 1], 0.5)
        for c in range(3):
            rays[i, c], rays[i, 3 + c] = o[c], d[c]
        rays[i, 6] = spread


def mapped(panorama, pixels):
    """Film coordinates of pixels of a square picture, their directions, and film and window coordinates of those."""
    real = build_camera(Camera("PANO", panorama=panorama), SQUARE, "BOX", 1.0).real
    xy = np.stack([pixels[:, 0] * real[CAMERA_SCALE_X] + real[CAMERA_OFFSET_X],
                   pixels[:, 1] * real[CAMERA_SCALE_Y] + real[CAMERA_OFFSET_Y]], axis=1).astype(np.float32)  # fmt: skip
    directions, back = np.zeros((len(xy), 3), np.float32), np.full((len(xy), 2), np.nan, np.float32)
    window = back.copy()
    _there_and_back(real, xy, directions, back, window)
    return xy, directions, back, window


def traced(camera, pixels, lens=(0.5, 0.5)):
    """Origins, directions and spreads."""
    pixels = np.asarray(pixels, np.float32)
    lens = np.broadcast_to(np.asarray(lens, np.float32), (len(pixels), 2)).copy()
    arrays = build_camera(camera, SQUARE, "BOX", 1.0)
    found = np.zeros((len(pixels), 7), np.float32)
    _rays(arrays.real, arrays.motion, pixels, lens, found)
    return found[:, :3], found[:, 3:6], found[:, 6]


@pytest.mark.parametrize("panorama", KINDS, ids=lambda p: p.kind)
def test_a_direction_is_seen_where_it_comes_from(panorama):
    pixels = np.random.default_rng(0).uniform(2.0, 62.0, (500, 2))
    xy, directions, back, window = mapped(panorama, pixels)
    sees = np.isfinite(back[:, 0])
    assert sees.mean() > 0.4
    np.testing.assert_allclose(np.linalg.norm(directions[sees], axis=1), 1.0, atol=1e-6)
    np.testing.assert_allclose(back[sees], xy[sees], atol=3e-4)
    np.testing.assert_allclose(window[sees], pixels[sees] / 64.0, atol=3e-4)


@pytest.mark.parametrize("panorama", [kind for kind in KINDS if "RECT" not in kind.kind and "CYL" not in kind.kind],
                         ids=lambda p: p.kind)  # fmt: skip
def test_the_middle_looks_ahead(panorama):
    _, directions, _, _ = mapped(panorama, np.array([[32.0, 32.0], [40.0, 32.0], [32.0, 40.0]]))
    np.testing.assert_allclose(directions[0], (0, 0, -1), atol=1e-6)
    assert directions[1, 0] > 0.1 and abs(directions[1, 1]) < 1e-6
    assert directions[2, 1] > 0.1 and abs(directions[2, 0]) < 1e-6


def test_angles_are_those_of_the_lenses():
    """A quarter of the picture right of the middle."""
    pixels = np.array([[48.0, 32.0]])
    for panorama, angle in (
        (Panorama("FISHEYE_EQUIDISTANT", fisheye_fov=3.0), 0.75),
        (Panorama("FISHEYE_EQUISOLID", fisheye_lens=10.0, sensor=(36.0, 36.0)), 2.0 * math.asin(9.0 / 20.0)),
        (Panorama("FISHEYE_LENS_POLYNOMIAL", polynomial=(0.0, -0.1, 0.0, 0.0, 0.0)), 0.9),
        (Panorama("EQUIANGULAR_CUBEMAP_FACE"), math.pi / 8),
        (Panorama("MIRRORBALL"), math.pi / 3),
        (Panorama("CENTRAL_CYLINDRICAL", cylinder=(-1.0, 3.0, -1.0, 1.0)), 2.0),
    ):
        _, directions, _, _ = mapped(panorama, pixels)
        expected = (math.sin(angle), 0.0, -math.cos(angle))
        np.testing.assert_allclose(directions[0], expected, atol=1e-5, err_msg=panorama.kind)


@pytest.mark.parametrize("kind", ["MIRRORBALL", "FISHEYE_EQUIDISTANT", "FISHEYE_EQUISOLID", "FISHEYE_LENS_POLYNOMIAL"])
def test_corners_see_nothing(kind):
    panorama = Panorama(kind, fisheye_lens=8.0, polynomial=(0.0, -0.1, 0.0, 0.0, 0.0))
    camera = Camera("PANO", panorama=panorama, use_dof=True, eye=StereoEye(0.1))
    _, directions, _ = traced(camera, [(0.5, 0.5), (63.5, 63.5), (32.0, 32.0)])
    assert (directions[:2] == 0.0).all() and np.linalg.norm(directions[2]) == pytest.approx(1.0)


@pytest.mark.parametrize("panorama", KINDS, ids=lambda p: p.kind)
def test_rays_spread_as_far_as_neighbours_lie_apart(panorama):
    camera = Camera("PANO", panorama=panorama)
    pixels = np.array([(30.0, 33.0), (31.0, 33.0), (30.0, 34.0)])
    _, directions, spread = traced(camera, pixels)
    apart = np.linalg.norm(directions[1:] - directions[0], axis=1).mean()
    assert spread[0] == pytest.approx(apart, rel=1e-3)


@pytest.mark.parametrize("panorama", KINDS, ids=lambda p: p.kind)
def test_the_lens_faces_where_it_looks(panorama):
    """Every point of the lens sees the same point in focus, from a place at a right angle to the direction."""
    camera = Camera("PANO", panorama=panorama, use_dof=True, focus_distance=2.0, aperture_fstop=0.05)
    _, plain, _ = traced(Camera("PANO", panorama=panorama), [(35.0, 38.0)])
    for lens in ((0.1, 0.9), (0.6, 0.4), (0.35, 1.0)):
        origin, direction, _ = traced(camera, [(35.0, 38.0)], lens)
        assert 0.1 < np.linalg.norm(origin) <= 0.5
        assert abs(origin[0] @ plain[0]) < 1e-6
        away = 2.0 * plain[0] - origin[0]
        np.testing.assert_allclose(direction[0], away / np.linalg.norm(away), atol=1e-5)


def test_eyes_turn_with_the_direction():
    full = Panorama()
    pixels = [(32.0, 32.0), (48.0, 32.0), (32.0, 50.0), (32.0, 63.9)]
    _, directions, _ = traced(Camera("PANO", panorama=full), pixels)
    for sign in (-1.0, 1.0):
        eye = StereoEye(0.03 * sign, 2.0, math.radians(60), math.radians(75))
        origins, seen, _ = traced(Camera("PANO", panorama=full, eye=eye), pixels)
        np.testing.assert_allclose(origins[0], (0.03 * sign, 0, 0), atol=1e-6)
        np.testing.assert_allclose(origins[1], (0, 0, 0.03 * sign), atol=1e-6)
        # Both eyes see the same at the distance of convergence, and the poles have one eye.
        away = 2.0 * directions[:3] - origins[:3]
        np.testing.assert_allclose(seen[:3], away / np.linalg.norm(away, axis=1)[:, None], atol=1e-5)
        assert (origins[3] == 0.0).all()
    origins, seen, _ = traced(Camera("PANO", panorama=full, eye=StereoEye(0.03)), pixels)
    np.testing.assert_allclose(seen, directions, atol=1e-6)


def test_unknown_kinds_are_named():
    with pytest.raises(ValueError, match="panorama type 'CUBE': choose one of EQUIRECTANGULAR, "):
        build_camera(Camera("PANO", panorama=Panorama("CUBE")), SQUARE, "BOX", 1.0)
    with pytest.raises(ValueError, match="NaN or infinity"):
        panorama = Panorama("FISHEYE_EQUIDISTANT", fisheye_fov=math.nan)
        build_camera(Camera("PANO", panorama=panorama), SQUARE, "BOX", 1.0)
