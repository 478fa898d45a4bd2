# SPDX-License-Identifier: GPL-3.0-or-later
"""Simplify's limits of textures: those of renders, and of viewports."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from addon.export.texture_limit import TextureLimit, read_limit
from engine.scene.image import Image
from tests.helpers.blender_scenes import empty_scene, export_context


@pytest.mark.parametrize("in_window", [False, True])
def test_limits_hold_where_simplify_is_on(in_window: bool) -> None:
    import bpy

    empty_scene()
    scene = bpy.context.scene
    scene.cycles.texture_limit, scene.cycles.texture_limit_render = "512", "1024"

    def limit() -> TextureLimit:
        context: Any = export_context()
        context.window = object() if in_window else None
        return read_limit(context)

    scene.render.use_simplify = False
    assert limit() == TextureLimit()
    scene.render.use_simplify = True
    assert limit().size == (512 if in_window else 1024)
    scene.cycles.texture_limit = scene.cycles.texture_limit_render = "OFF"
    scene.update_tag()
    assert limit() == TextureLimit()


def test_a_limit_halves_images() -> None:
    image = Image("k", "image", np.zeros((100, 300, 4), np.uint8))
    assert TextureLimit(128).apply(image).pixels.shape == (25, 75, 4)
    assert TextureLimit(512).apply(image) is image
    assert TextureLimit(512, 0.5).apply(image).pixels.shape == (50, 150, 4)
