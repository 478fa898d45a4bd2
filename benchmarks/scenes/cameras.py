# SPDX-License-Identifier: GPL-3.0-or-later
"""One scene per kind of camera and film setting."""

from __future__ import annotations

import math
from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import camera, diffuse, lit_stage, resolution, show


def _studio() -> Any:
    """The lit stage with its sphere and box; returns the camera object."""
    lit_stage()
    show(diffuse((0.7, 0.6, 0.5)))
    return bpy.context.scene.camera


@scene("camera-vertical-fit")
def vertical_fit() -> None:
    """Vertical sensor fit, wide lens."""
    data = _studio().data
    data.sensor_fit, data.lens, data.sensor_height = "VERTICAL", 30.0, 20.0


@scene("camera-portrait")
def portrait() -> None:
    """An upright image with automatic sensor fit."""
    _studio()
    resolution(60, 90)


@scene("camera-pixel-aspect")
def pixel_aspect() -> None:
    """Pixels twice as wide as high."""
    _studio()
    bpy.context.scene.render.pixel_aspect_x = 2.0


@scene("camera-shift")
def shift() -> None:
    """A shifted lens."""
    data = _studio().data
    data.shift_x, data.shift_y = 0.15, -0.1


@scene("camera-depth-of-field", samples=128)
def depth_of_field() -> None:
    """A wide open round aperture."""
    data = _studio().data
    data.dof.use_dof, data.dof.focus_distance, data.dof.aperture_fstop = True, 5.5, 0.1


@scene("camera-depth-of-field-blades", samples=128)
def depth_of_field_blades() -> None:
    """A five-bladed, turned, squeezed aperture focused on an object."""
    data = _studio().data
    data.dof.use_dof, data.dof.aperture_fstop = True, 0.08
    data.dof.focus_object = bpy.data.objects["Right"]
    data.dof.aperture_blades, data.dof.aperture_rotation, data.dof.aperture_ratio = 5, math.radians(20), 1.5


@scene("camera-ortho")
def ortho() -> None:
    """An orthographic camera, shifted."""
    data = _studio().data
    data.type, data.ortho_scale, data.shift_x = "ORTHO", 5.5, 0.05


@scene("camera-ortho-depth-of-field", samples=128)
def ortho_depth_of_field() -> None:
    """An orthographic camera with depth of field."""
    data = _studio().data
    data.type, data.ortho_scale = "ORTHO", 5.5
    data.dof.use_dof, data.dof.focus_distance, data.dof.aperture_fstop = True, 5.5, 4.0


@scene("camera-panorama")
def panorama() -> None:
    """A full equirectangular panorama from between the objects."""
    _studio()
    created = camera((0.1, -1.4, 1.0), (0.0, 1.0, 0.8))
    created.data.type = "PANO"
    created.data.panorama_type = "EQUIRECTANGULAR"
    resolution(128, 64)


@scene("camera-panorama-range")
def panorama_range() -> None:
    """Part of an equirectangular panorama."""
    panorama()
    data = bpy.context.scene.camera.data
    data.latitude_min, data.latitude_max = math.radians(-50), math.radians(30)
    data.longitude_min, data.longitude_max = math.radians(-70), math.radians(100)


def _small_panorama(kind: str) -> Any:
    """The studio from between the objects, in a square; the camera's data."""
    panorama()
    resolution(96, 72)
    data = bpy.context.scene.camera.data
    data.panorama_type = kind
    return data


@scene("camera-mirror-ball")
def mirror_ball() -> None:
    """What a mirror ball reflects; black beside it."""
    _small_panorama("MIRRORBALL")


@scene("camera-cubemap-face")
def cubemap_face() -> None:
    """A face of a cube map, at even angles."""
    _small_panorama("EQUIANGULAR_CUBEMAP_FACE")


@scene("camera-fisheye")
def fisheye() -> None:
    """An equidistant fisheye of 220 degrees with depth of field and a shifted film."""
    data = _small_panorama("FISHEYE_EQUIDISTANT")
    data.fisheye_fov = math.radians(220)
    data.shift_x, data.shift_y = 0.1, -0.05
    data.dof.use_dof, data.dof.focus_distance, data.dof.aperture_fstop = True, 1.0, 0.3
    data.dof.aperture_blades, data.dof.aperture_ratio = 5, 1.5


@scene("camera-fisheye-equisolid")
def fisheye_equisolid() -> None:
    """A fisheye that keeps areas, on a full frame."""
    data = _small_panorama("FISHEYE_EQUISOLID")
    data.fisheye_lens, data.fisheye_fov = 10.0, math.radians(160)


@scene("camera-fisheye-polynomial")
def fisheye_polynomial() -> None:
    """A fisheye by a polynomial, on a sensor fitted by its height."""
    data = _small_panorama("FISHEYE_LENS_POLYNOMIAL")
    data.sensor_fit, data.sensor_height = "VERTICAL", 24.0
    data.fisheye_polynomial_k1, data.fisheye_polynomial_k2, data.fisheye_polynomial_k3 = -0.09, 1e-3, -2e-5


@scene("camera-cylinder")
def cylinder() -> None:
    """A cylinder of another radius, not the whole way round."""
    data = _small_panorama("CENTRAL_CYLINDRICAL")
    data.central_cylindrical_range_u_min, data.central_cylindrical_range_u_max = -2.5, 2.0
    data.central_cylindrical_range_v_min, data.central_cylindrical_range_v_max = -1.0, 1.5
    data.central_cylindrical_radius = 1.5


@scene("camera-clipping")
def clipping() -> None:
    """Near and far clipping cut the sphere and the background."""
    data = _studio().data
    data.clip_start, data.clip_end = 5.6, 7.2


@scene("camera-border")
def border() -> None:
    """A render border without crop: the rest stays empty."""
    _studio()
    render = bpy.context.scene.render
    render.use_border, render.use_crop_to_border = True, False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.25, 0.8, 0.1, 0.7


@scene("camera-border-crop")
def border_crop() -> None:
    """A render border with crop."""
    border()
    bpy.context.scene.render.use_crop_to_border = True


@scene("camera-scaled")
def scaled() -> None:
    """A camera under a scaled and sheared parent."""
    created = _studio()
    created.scale = (2.0, 0.5, 3.0)


@scene("film-transparent")
def film_transparent() -> None:
    """A transparent film: the picture's alpha is compared too."""
    _studio()
    bpy.data.objects.remove(bpy.data.objects["Floor"])
    bpy.context.scene.render.film_transparent = True


@scene("film-exposure")
def film_exposure() -> None:
    """Film exposure of 2.5."""
    _studio()
    bpy.context.scene.cycles.film_exposure = 2.5


@scene("film-box-filter")
def film_box_filter() -> None:
    """A box pixel filter."""
    _studio()
    bpy.context.scene.cycles.pixel_filter_type = "BOX"


@scene("film-gaussian-filter")
def film_gaussian_filter() -> None:
    """A wide Gaussian pixel filter."""
    _studio()
    bpy.context.scene.cycles.pixel_filter_type = "GAUSSIAN"
    bpy.context.scene.cycles.filter_width = 4.0
