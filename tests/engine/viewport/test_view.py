# SPDX-License-Identifier: GPL-3.0-or-later
"""Views as cameras and frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.builder.camera import build_camera
from engine.scene.description import Camera
from engine.scene.panorama import Panorama
from engine.settings import RenderSettings
from engine.state.camera import CAMERA_OFFSET_X, CAMERA_OFFSET_Y, CAMERA_SCALE_X, CAMERA_SCALE_Y
from engine.viewport.view import Plane, Update, View

PLANE = Plane(-0.3, 0.5, -0.1, 0.35)


def edges(view: View, divider: int, x: float, y: float) -> tuple[float, float]:
    """Film coordinates at a point of the window, in pixels of the picture that `divider` gives."""
    camera, frame = view.at(divider)
    real = build_camera(camera, frame, "BOX", 1.0).real
    return (
        float(x / divider * real[CAMERA_SCALE_X] + real[CAMERA_OFFSET_X]),
        float(y / divider * real[CAMERA_SCALE_Y] + real[CAMERA_OFFSET_Y]),
    )


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO", "PANO"])
@pytest.mark.parametrize("size", [(960, 540), (541, 967), (7, 3), (1, 1)])
@pytest.mark.parametrize("divider", [1, 2, 8, 32])
def test_every_divider_sees_the_same_plane(kind: str, size: tuple[int, int], divider: int) -> None:
    width, height = size
    camera = Camera(kind=kind, lens=35.0, panorama=Panorama("MIRRORBALL"))
    view = View(camera, PLANE, width, height, (0, 0, width, height))
    assert edges(view, divider, 0, 0) == pytest.approx((PLANE.left, PLANE.bottom), abs=1e-5)
    assert edges(view, divider, width, height) == pytest.approx((PLANE.right, PLANE.top), abs=1e-5)


def test_the_lens_stays_for_the_sake_of_the_aperture() -> None:
    view = View(Camera(lens=85.0, use_dof=True), PLANE, 100, 50, (0, 0, 100, 50))
    assert view.at(4)[0].lens == 85.0


@pytest.mark.parametrize("divider", [1, 2, 4, 8])
def test_a_coarse_picture_covers_the_region(divider: int) -> None:
    view = View(Camera(), PLANE, 101, 67, (13, 5, 90, 61))
    x0, y0, x1, y1 = view.at(divider)[1].region
    assert x0 * divider <= 13 and y0 * divider <= 5 and x1 * divider >= 90 and y1 * divider >= 61
    assert x0 * divider > 13 - divider and x1 * divider < 90 + divider


def test_views_differ_by_all_that_is_seen() -> None:
    view = View(Camera(), PLANE, 100, 50, (0, 0, 100, 50))
    assert view.differs(None)
    assert not view.differs(replace(view, camera=Camera(transform=np.eye(4, dtype=np.float32))))
    moved = np.eye(4, dtype=np.float32)
    moved[0, 3] = 1e-3
    others = (
        replace(view, camera=Camera(transform=moved)), replace(view, camera=Camera(use_dof=True)),
        replace(view, plane=Plane(-0.3, 0.5, -0.1, 0.36)), replace(view, width=101), replace(view, exposure=2.0),
        replace(view, region=(0, 0, 99, 50)),
    )  # fmt: skip
    assert all(view.differs(other) for other in others)


def test_two_updates_are_one() -> None:
    view = View(Camera(), PLANE, 100, 50, (0, 0, 100, 50))
    first = Update(view=view, settings=RenderSettings(samples=3))
    both = first.then(Update(settings=RenderSettings(samples=5), is_paused=False))
    assert both.view is view and both.settings.samples == 5 and both.is_paused is False and both.scene is None


def test_factors_alone_are_told_from_all_else() -> None:
    mix = Update(mix={"Key": (2.0, 2.0, 2.0)})
    assert mix.is_mix_alone and not mix.is_empty
    assert mix.then(Update(mix={"Key": (1.0, 1.0, 1.0)})) == Update(mix={"Key": (1.0, 1.0, 1.0)})
    assert not mix.then(Update(is_paused=True)).is_mix_alone
    assert not Update().is_mix_alone and not Update(is_paused=False).is_mix_alone
