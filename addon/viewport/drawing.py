# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws pictures into a window. `gpu` is imported where it is used: it does not exist without a window."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    import bpy

    from engine.viewport.protocol import ViewImage


class Canvas:
    """The newest picture as a texture."""

    def __init__(self) -> None:
        self._texture: Any = None
        self._rectangle = (0, 0, 0, 0)

    def take(self, image: ViewImage) -> None:
        """Make a texture of a picture; needs the window's GPU context."""
        import gpu

        height, width = image.pixels.shape[:2]
        # Freed before the next is made: pictures of large windows are large.
        self._texture = None
        pixels = gpu.types.Buffer("FLOAT", width * height * 4, image.pixels.reshape(-1))
        self._texture = gpu.types.GPUTexture((width, height), format="RGBA16F", data=pixels)
        self._rectangle = image.rectangle

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing to draw."""
        return self._texture is None

    def draw(self, engine: bpy.types.RenderEngine, scene: bpy.types.Scene) -> None:
        """Draw what there is, with the window's colour management, over what is there."""
        if self._texture is None:
            return
        import gpu
        from gpu_extras.presets import draw_texture_2d

        x0, y0, x1, y1 = self._rectangle
        gpu.state.blend_set("ALPHA_PREMULT")
        engine.bind_display_space_shader(scene)
        try:
            draw_texture_2d(self._texture, (x0, y0), x1 - x0, y1 - y0)
        finally:
            engine.unbind_display_space_shader()
            gpu.state.blend_set("NONE")
