# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays against Blender's own projection, and the pixel filter's distribution."""

import itertools
from dataclasses import replace

import numpy as np
import pytest

from engine.builder.camera import build_camera, filter_table
from engine.kernels.camera import generate_ray, sample_table, time_of_row
from engine.runtime.jit import kernel
from engine.scene.description import Camera, Frame
from engine.state.camera import CAMERA_IS_ZOOMING, CAMERA_ROLLING


@kernel
def _rays(camera, motion, xy, lens, time, origin, direction):
    for i in range(xy.shape[0]):
        o, d, _, _, _, _ = generate_ray(camera, motion, xy[i, 0], xy[i, 1], lens[i, 0], lens[i, 1], time)
        for c in range(3):
            origin[i, c] = o[c]
            direction[i, c] = d[c]


@kernel
def _times(camera, times, rows, out):
    for i in range(times.shape[0]):
        out[i] = time_of_row(camera, times[i], rows[i])


@kernel
def _filter(table, u, out):
    for i in range(u.shape[0]):
        out[i] = sample_table(table, u[i])


def rays(camera, frame, xy, lens=None, time=0.5):
    xy = np.asarray(xy, np.float32)
    lens = np.full((len(xy), 2), 0.5, np.float32) if lens is None else lens
    origin, direction = np.zeros((len(xy), 3), np.float32), np.zeros((len(xy), 3), np.float32)
    arrays = build_camera(camera, frame, "BOX", 1.0)
    _rays(arrays.real, arrays.motion, xy, lens, np.float32(time), origin, direction)
    return origin, direction


@pytest.mark.parametrize(
    ("kind", "fit", "size", "aspect"),
    list(
        itertools.product(
            ("PERSP", "ORTHO"), ("AUTO", "HORIZONTAL", "VERTICAL"), ((64, 36), (30, 50)), ((1, 1), (2, 1))
        )
    ),
)
def test_rays_pass_through_the_pixels_blender_projects_to(blender, kind, fit, size, aspect):
    from bpy_extras.object_utils import world_to_camera_view

    from addon.export import export_scene

    bpy = blender
    scene = bpy.context.scene
    data = bpy.data.cameras.new("Camera")
    data.type, data.sensor_fit = kind, fit
    data.lens, data.sensor_width, data.sensor_height = 31.0, 30.0, 22.0
    data.shift_x, data.shift_y, data.ortho_scale = 0.13, -0.07, 5.0
    camera = bpy.data.objects.new("Camera", data)
    camera.location, camera.rotation_euler = (1.0, -7.0, 3.0), (1.1, 0.1, 0.3)
    scene.collection.objects.link(camera)
    scene.camera = camera
    scene.render.resolution_x, scene.render.resolution_y = size
    scene.render.resolution_percentage = 100
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    description = export_scene(bpy.context.evaluated_depsgraph_get())

    pixels = np.array([(3.25, 5.5), (size[0] - 1.5, 2.0), (size[0] / 2, size[1] / 2)])
    origin, direction = rays(description.camera, description.frame, pixels)
    for pixel, o, d in zip(pixels, origin, direction, strict=True):
        from mathutils import Vector

        seen = world_to_camera_view(scene, camera, Vector(o + 4.0 * d))
        assert np.allclose((seen.x * size[0], seen.y * size[1]), pixel, atol=2e-3)


def test_lens_points_all_focus_on_one_point():
    camera = Camera(use_dof=True, focus_distance=3.0, aperture_fstop=0.5)
    lens = np.random.default_rng(0).random((64, 2)).astype(np.float32)
    origin, direction = rays(camera, Frame(32, 32, (0, 0, 32, 32)), [(5.0, 20.0)] * 64, lens)
    assert np.ptp(origin[:, 0]) > 0.05
    focus = origin + direction * (-3.0 / direction[:, 2:3])
    assert np.allclose(focus, focus[0], atol=1e-5)


@pytest.mark.parametrize("blades", [0, 3, 6])
def test_aperture_has_its_shape(blades):
    """Lens points lie within the polygon and fill it: their mean squared radius is the shape's."""
    camera = Camera(use_dof=True, focus_distance=3.0, aperture_fstop=0.5, aperture_blades=blades)
    lens = np.random.default_rng(1).random((20000, 2)).astype(np.float32)
    origin, _ = rays(camera, Frame(32, 32, (0, 0, 32, 32)), [(16.0, 16.0)] * 20000, lens)
    radius = np.hypot(origin[:, 0], origin[:, 1]) / (0.05 / (2 * 0.5))
    assert radius.max() <= 1.0 + 1e-5
    # Polar second moment over area of a regular polygon with unit circumradius.
    expected = 0.5 if blades == 0 else (2.0 + np.cos(2.0 * np.pi / blades)) / 6.0
    assert np.mean(radius**2) == pytest.approx(expected, abs=0.01)


def test_equirectangular_covers_the_sphere_and_looks_along_minus_z():
    camera = Camera(kind="PANO")
    frame = Frame(64, 32, (0, 0, 64, 32))
    _, direction = rays(camera, frame, [(32.0, 16.0), (48.0, 16.0), (32.0, 32.0), (0.0, 16.0)])
    assert np.allclose(direction, [(0, 0, -1), (1, 0, 0), (0, 1, 0), (0, 0, 1)], atol=1e-5)


@pytest.mark.parametrize(("name", "width"), [("BOX", 1.0), ("GAUSSIAN", 1.5), ("BLACKMAN_HARRIS", 1.5)])
def test_filter_offsets_follow_the_filter(name, width):
    """Means and variances of 200,000 offsets against the filter's own, to five standard errors."""
    u = ((np.arange(200_000) + 0.5) / 200_000).astype(np.float32)
    out = np.zeros_like(u)
    _filter(filter_table(name, width), u, out)
    support = {"BOX": 1.0, "GAUSSIAN": 3.0, "BLACKMAN_HARRIS": 2.0}[name] * width
    x = np.linspace(-support / 2, support / 2, 20001)
    if name == "BOX":
        weight = np.ones_like(x)
    elif name == "GAUSSIAN":
        weight = np.exp(-2.0 * (6.0 * x / support) ** 2)
    else:
        t = 2 * np.pi * (x / support + 0.5)
        weight = 0.35875 - 0.48829 * np.cos(t) + 0.14128 * np.cos(2 * t) - 0.01168 * np.cos(3 * t)
    variance = np.sum(weight * x * x) / np.sum(weight)
    assert abs(out.mean()) < 1e-3
    assert out.var() == pytest.approx(variance, rel=0.01)
    assert np.abs(out).max() <= support / 2


LENSES = {"lens": (20.0, 35.0, 80.0), "sensor_width": (30.0, 36.0, 24.0), "sensor_height": (20.0, 24.0, 30.0)}


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(64, 36), (30, 50)])
def test_a_zoom_is_straight_between_opening_middle_and_closing(fit, size):
    """As Cycles: what goes straight is where a pixel is on the film, not the angle, and not the focal length."""
    frame = Frame(*size, (0, 0, *size))
    pixels = np.random.default_rng(2).uniform(0.0, 1.0, (16, 2)) * size

    def film(camera, time=0.5):
        _, direction = rays(camera, frame, pixels, time=time)
        return direction[:, :2] / -direction[:, 2:]

    still = [
        Camera(sensor_fit=fit, shift_x=0.2, shift_y=-0.1, **{name: v[k] for name, v in LENSES.items()})
        for k in range(3)
    ]
    opening, middle, closing = (film(camera) for camera in still)
    zooming = replace(still[1], lens_motion=np.array([[v[k] for v in LENSES.values()] for k in (0, 2)], np.float32))
    for time, expected in (
        (0.0, opening), (0.25, 0.5 * (opening + middle)), (0.5, middle), (0.9, 0.2 * middle + 0.8 * closing),
        (1.0, closing),
    ):  # fmt: skip
        np.testing.assert_allclose(film(zooming, time), expected, rtol=1e-5, atol=1e-6)
    assert np.abs(opening - closing).max() > 0.3


def test_a_zoom_keeps_the_plane_in_focus():
    lens = np.random.default_rng(0).random((64, 2)).astype(np.float32)
    motion = np.array([(20.0, 36.0, 24.0), (90.0, 36.0, 24.0)], np.float32)
    camera = Camera(use_dof=True, focus_distance=3.0, aperture_fstop=0.5, lens_motion=motion)
    for time in (0.0, 0.3, 0.8):
        origin, direction = rays(camera, Frame(32, 32, (0, 0, 32, 32)), [(5.0, 20.0)] * 64, lens, time)
        # The lens itself is as large as in the middle.
        assert 0.045 < np.hypot(origin[:, 0], origin[:, 1]).max() <= 0.05
        focus = origin + direction * (-3.0 / direction[:, 2:3])
        assert np.allclose(focus, focus[0], atol=1e-5)


def test_cameras_that_do_not_zoom_are_left_alone():
    frame = Frame(32, 24, (0, 0, 32, 24))
    same = np.array([(50.0, 36.0, 24.0)] * 2, np.float32)
    other = np.array([(20.0, 36.0, 24.0)] * 2, np.float32)
    for camera in (Camera(lens_motion=same), Camera(kind="ORTHO", lens_motion=other),
                   Camera(kind="PANO", lens_motion=other)):  # fmt: skip
        real = build_camera(camera, frame, "BOX", 1.0).real
        assert real[CAMERA_IS_ZOOMING] == 0.0 and real[CAMERA_ROLLING] == 0.0
        found = [rays(camera, frame, [(3.0, 20.0)], time=time) for time in (0.0, 0.5, 1.0)]
        assert np.array_equal(found[0], found[1]) and np.array_equal(found[0], found[2])


@pytest.mark.parametrize("duration", [0.0, 0.25, 1.0])
def test_rows_are_exposed_from_the_top_to_the_bottom(duration):
    height = 40
    # Rows of a picture with a border are still those of the full image.
    frame = Frame(16, height, (4, 10, 12, 30))
    camera = build_camera(Camera(), frame, "BOX", 1.0, rolling_shutter_duration=duration).real
    rows = np.repeat(np.arange(height), 3).astype(np.int32)
    times = np.tile(np.array([0.0, 0.3, 1.0], np.float32), height)
    out = np.zeros_like(times)
    _times(camera, times, rows, out)
    np.testing.assert_allclose(out, times * duration + (1.0 - rows / height) * (1.0 - duration), atol=1e-6)
    assert out.min() >= 0.0 and out.max() <= 1.0
    if duration == 1.0:
        assert np.array_equal(out, times)
    else:
        # The bottom row's part ends where the shutter closes.
        assert out[rows == 0].max() == pytest.approx(1.0) and out[rows == height - 1].min() < 0.03


def test_a_rolling_shutter_of_no_number_does_not_roll():
    frame = Frame(4, 4, (0, 0, 4, 4))
    for duration in (np.nan, 2.0):
        camera = build_camera(Camera(), frame, "BOX", 1.0, rolling_shutter_duration=duration).real
        out = np.zeros(1, np.float32)
        _times(camera, np.array([0.3], np.float32), np.array([1], np.int32), out)
        assert out[0] == np.float32(0.3)


@pytest.mark.parametrize("lens", [0.0, -5.0, np.nan, np.inf])
def test_zooms_to_nowhere_are_named(lens):
    motion = np.array([(lens, 36.0, 24.0), (50.0, 36.0, 24.0)], np.float32)
    with pytest.raises(ValueError, match="zooms to nothing or infinity"):
        build_camera(Camera(lens_motion=motion), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)


@pytest.mark.parametrize("name", ["lens", "sensor_width", "clip_start", "shift_x", "focus_distance", "aperture_fstop"])
def test_settings_of_no_number_are_named(name):
    camera = Camera(use_dof=True, **{name: np.nan})
    with pytest.raises(ValueError, match="NaN or infinity"):
        build_camera(camera, Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)
    # Without depth of field nobody asks for its settings.
    if name in ("focus_distance", "aperture_fstop"):
        build_camera(replace(camera, use_dof=False), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)


def test_bad_cameras_are_named():
    with pytest.raises(ValueError, match="resolution"):
        build_camera(Camera(), Frame(0, 4, (0, 0, 0, 0)), "BOX", 1.0)
    with pytest.raises(ValueError, match="scale"):
        build_camera(Camera(transform=np.zeros((4, 4), np.float32)), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)
    with pytest.raises(ValueError, match="FISHEYE"):
        build_camera(Camera(kind="FISHEYE"), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)
