# SPDX-License-Identifier: GPL-3.0-or-later
"""What a view shows, and how it is told: plain data that crosses from the host to the process."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

from engine.scene.content import same_content
from engine.scene.description import Camera, Frame, SceneDescription
from engine.settings import RenderSettings

Region = tuple[int, int, int, int]
#: Of a light group: for red, green and blue.
Factor = tuple[float, float, float]


class Plane(NamedTuple):
    """What a window sees: edges of its left, right, bottom and top.

    At distance 1 of a perspective camera, in metres of an orthographic one, in widths and heights of a panorama's film.
    """

    left: float
    right: float
    bottom: float
    top: float


@dataclass(frozen=True)
class View:
    """A window's view of the scene.

    camera : Camera, whose opening is `plane`, whatever its own lens, sensor and shift say
    width, height : int, of the window [pixels]
    region : (x0, y0, x1, y1), the part of it that is rendered, y from the bottom
    exposure : float, film exposure
    """

    camera: Camera
    plane: Plane
    width: int
    height: int
    region: Region
    exposure: float = 1.0

    def at(self, divider: int) -> tuple[Camera, Frame]:
        """Camera and frame whose pixels are squares of `divider` by `divider` pixels of the window.

        The frame may reach beyond the window by a part of such a square.
        """
        width, height = -(-self.width // divider), -(-self.height // divider)
        x0, y0, x1, y1 = self.region
        region = (x0 // divider, y0 // divider, -(-x1 // divider), -(-y1 // divider))
        left, right, bottom, top = self.plane
        plane = Plane(
            left, left + (right - left) * width * divider / self.width,
            bottom, bottom + (top - bottom) * height * divider / self.height,
        )  # fmt: skip
        across, up = plane.right - plane.left, plane.top - plane.bottom
        # Pixels as wide as the plane says, whatever shape the window has.
        aspect = across * height / (up * width) if self.camera.kind != "PANO" else 1.0
        frame = Frame(width, height, region, pixel_aspect_x=aspect, exposure=self.exposure)
        return opened(self.camera, plane), frame

    def differs(self, other: View | None) -> bool:
        """Whether it shows something else than another one."""
        return other is None or not same_content(self, other)


def opened(camera: Camera, plane: Plane) -> Camera:
    """The camera with the lens and sensor that see just `plane`, in a frame of the plane's shape."""
    across = plane.right - plane.left
    shift_x = 0.5 * (plane.left + plane.right) / across
    shift_y = 0.5 * (plane.bottom + plane.top) / across
    if camera.kind == "PANO":
        window = plane.left, plane.right, plane.bottom, plane.top
        return replace(camera, panorama=replace(camera.panorama, window=window))
    if camera.kind == "ORTHO":
        return replace(camera, sensor_fit="HORIZONTAL", ortho_scale=across, shift_x=shift_x, shift_y=shift_y)
    # The lens stays, since the aperture's size goes by it.
    return replace(
        camera, sensor_fit="HORIZONTAL", sensor_width=across * camera.lens, shift_x=shift_x, shift_y=shift_y
    )


@dataclass(frozen=True)
class Update:
    """What has changed since the last one; None: nothing.

    view : View
    scene : SceneDescription, whose camera and frame do not count
    settings : RenderSettings, samples, noise threshold and denoising those of the view
    denoises_from : int, samples a pixel before which nothing is denoised
    is_paused : bool, whether the process is to wait
    mix : dict of three floats, what the light of each light group is multiplied by; as long as it is empty no groups
        are kept, and with the first factors the picture starts anew
    """

    view: View | None = None
    scene: SceneDescription | None = None
    settings: RenderSettings | None = None
    denoises_from: int | None = None
    is_paused: bool | None = None
    mix: dict[str, Factor] | None = None

    @property
    def is_empty(self) -> bool:
        """Whether nothing has changed."""
        return all(value is None for value in self.__dict__.values())

    @property
    def is_mix_alone(self) -> bool:
        """Whether nothing but the factors of light groups has changed."""
        return self.mix is not None and replace(self, mix=None).is_empty

    def then(self, later: Update) -> Update:
        """Both as one."""
        return Update(
            **{name: getattr(self if new is None else later, name) for name, new in later.__dict__.items()}
        )
