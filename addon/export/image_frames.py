# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames of image sequences and movies: which one a texture shows, and where it is."""

from __future__ import annotations

import os

import bpy


def shown_frame(image: bpy.types.Image, user: bpy.types.ImageUser | None, scene_frame: int) -> int | None:
    """Number of the frame that a texture shows; None for everything that is neither sequence nor movie.

    As Blender's `BKE_image_user_frame_get`. Auto Refresh is for windows: renders go by the scene's frame without it.
    """
    if image.source not in ("SEQUENCE", "MOVIE") or user is None:
        return None
    length = user.frame_duration
    if length <= 0:
        return 0
    frame = scene_frame - user.frame_start + 1
    if user.use_cyclic:
        frame = (frame - 1) % length + 1
    return min(max(frame, 0), length) + user.frame_offset


def image_path(image: bpy.types.Image, frame: int | None = None) -> str:
    """The file of an image, or the one of a sequence that is its frame."""
    path = bpy.path.abspath(image.filepath_raw, library=image.library)
    if frame is None or image.source == "MOVIE":
        return path
    # As Blender: the last run of digits in the file's name counts the frames.
    folder, name = os.path.split(path)
    stem, extension = os.path.splitext(name)
    end = len(stem)
    while end > 0 and not stem[end - 1].isdigit():
        end -= 1
    start = end
    while start > 0 and stem[start - 1].isdigit():
        start -= 1
    if start == end:
        return path
    return os.path.join(folder, f"{stem[:start]}{frame:0{end - start}d}{stem[end:]}{extension}")


def show_frame(movie: bpy.types.Image, frame: int) -> None:
    """Have `movie.pixels` give a frame, the first or last where there is none of that number.

    They give the frame that was looked at last, and what looks at any is a texture of Blender's old kind.
    """
    texture = bpy.data.textures.new("NeuralGuide", "IMAGE")
    try:
        texture.image = movie
        texture.image_user.frame_current = frame
        texture.evaluate((0.0, 0.0, 0.0))
        texture.image = None
    finally:
        bpy.data.textures.remove(texture, do_unlink=False)
