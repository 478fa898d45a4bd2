# SPDX-License-Identifier: GPL-3.0-or-later
"""Images that show light mixes, and image editors that show them instead of what they were made of."""

from __future__ import annotations

from collections.abc import Callable, Iterator

import bpy
import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]

#: Editors that were given another image; undoing changes no windows.
_turned: set[int] = set()


def put(name: str, picture: Float32Array) -> bpy.types.Image:
    """The image of a name with these pixels: the one that there is, if it is of their size.

    Parameters
    ----------
    name : str
    picture : float32 (height, width, 4), scene-linear, premultiplied, row 0 at the bottom
    """
    height, width = picture.shape[:2]
    image = bpy.data.images.get(name)
    is_fit = image is not None and image.source == "GENERATED" and image.is_float
    if image is not None and not (is_fit and tuple(image.size) == (width, height)):
        bpy.data.images.remove(image)
        image = None
    if image is None:
        image = bpy.data.images.new(name, width, height, alpha=True, float_buffer=True)
        image.alpha_mode = "PREMUL"
        # The view transform, exposure and look of the Render Result.
        image.use_view_as_render = True
    image.pixels.foreach_set(np.ascontiguousarray(picture).reshape(-1))
    image.update()
    return image


def problem_of(make: Callable[[], object]) -> str:
    """Make a mix; returns why that did not work, '' where it did. Blender would put it where nobody looks."""
    try:
        make()
    except MemoryError:
        return "out of memory: render smaller, or with fewer light groups"
    except (ValueError, RuntimeError) as error:  # a factor that is no number; the denoiser
        return str(error)
    return ""


def editors() -> Iterator[tuple[bpy.types.Window, bpy.types.Area]]:
    """Image editors of all windows."""
    for window in getattr(bpy.context.window_manager, "windows", ()):
        for area in window.screen.areas:
            if area.type == "IMAGE_EDITOR":
                yield window, area


def turn(area: bpy.types.Area, image: bpy.types.Image) -> None:
    """Have an editor show another image."""
    area.spaces.active.image = image
    area.tag_redraw()
    _turned.add(area.as_pointer())


def turn_back(area: bpy.types.Area, image: bpy.types.Image) -> None:
    """Have an editor that was turned show an image, where undoing has taken away what it showed."""
    if area.as_pointer() in _turned and area.spaces.active.image is None:
        turn(area, image)


def forget() -> None:
    """Forget which editors were turned: another file has others."""
    _turned.clear()
