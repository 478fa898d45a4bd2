# SPDX-License-Identifier: GPL-3.0-or-later
"""Camera rays against Blender's own projection, and the pixel filter's distribution."""

import itertools

import numpy as np
import pytest

from engine.jit import kernel
from engine.kernels.camera import generate_ray, sample_table
from engine.scene.camera import build_camera, filter_table
from engine.scene.description import Camera, Frame


@kernel
def _rays(camera, motion, xy, lens, time, origin, direction):
    for i in range(xy.shape[0]):
        o, d, _, _, _, _ = generate_ray(camera, motion, xy[i, 0], xy[i, 1], lens[i, 0], lens[i, 1], time)
        for c in range(3):
            origin[i, c] = o[c]
            direction[i, c] = d[c]


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
    camera = Camera(kind="PANO_EQUIRECTANGULAR")
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


def test_bad_cameras_are_named():
    with pytest.raises(ValueError, match="resolution"):
        build_camera(Camera(), Frame(0, 4, (0, 0, 0, 0)), "BOX", 1.0)
    with pytest.raises(ValueError, match="scale"):
        build_camera(Camera(transform=np.zeros((4, 4), np.float32)), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)
    with pytest.raises(ValueError, match="FISHEYE"):
        build_camera(Camera(kind="FISHEYE"), Frame(4, 4, (0, 0, 4, 4)), "BOX", 1.0)
