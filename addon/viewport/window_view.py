# SPDX-License-Identifier: GPL-3.0-or-later
"""One window in rendered shading: Blender's hooks in, messages to the process and pictures out."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Any

from engine.scene.content import same_content
from engine.viewport.protocol import DEAD, FAILED, RENDERING, Status

from ..export import ExportCache, ExportContext, StudioLight, Window, export_scene
from ..export.culling import culls
from ..log import logger
from .camera import culling_view, dicing_view, read_view
from .classify import Change, Touched, classify
from .drawing import Canvas
from .host import Host, acquire, release
from .settings import denoises_from, is_paused, preview_settings, shown_mix

if TYPE_CHECKING:
    import bpy

    from engine.settings import RenderSettings
    from engine.viewport.view import Factor, View

#: How long a window must keep its size before it is rendered in it [s].
_RESIZE_SECONDS = 0.3


class WindowView:
    """What one window shows.

    Parameters
    ----------
    canvas : Canvas, optional
        Where pictures go; another one where there is no window.
    """

    def __init__(self, canvas: Canvas | None = None) -> None:
        self.host: Host = acquire(ExportCache)
        self._canvas = Canvas() if canvas is None else canvas
        #: What is to be read again, and original datablocks that were touched, since the last export.
        self._change = Change.TOPOLOGY
        self._touched: set[int] | None = None
        self._window_key: object = None
        self._settings: RenderSettings | None = None
        self._problem = ""
        self._resized = 0.0
        self._size: tuple[int, int] | None = None
        #: Notices that the terminal has, and the log of whoever started Blender from one.
        self._told: set[tuple[str, str, str]] = set()

    def close(self) -> None:
        """The window is gone, or shows something else."""
        release(self.host)

    # What has changed

    def update(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Take note of what Blender says has changed."""
        touched, addresses = [], set()
        for update in depsgraph.updates:
            item = update.id
            touched.append(
                Touched(
                    item.bl_rna.identifier, getattr(item, "type", "") if item.bl_rna.identifier == "Object" else "",
                    update.is_updated_geometry, update.is_updated_transform, update.is_updated_shading,
                )
            )  # fmt: skip
            addresses.add(item.original.as_pointer())
        scene = self.host.scene
        reads_objects = scene is not None and bool(scene.instances.properties)
        self._change |= classify(touched, reads_objects=reads_objects)
        if self._touched is not None:
            self._touched |= addresses

    def _export(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph, view: View) -> None:
        """Read again what can have changed; nothing of Blender's is read later, or elsewhere."""
        space = context.space_data
        shading = space.shading
        studio = None if shading.use_scene_world_render else _studio_light(shading)
        key = (bool(shading.use_scene_lights_render), studio, space.local_view is None)
        if key != self._window_key:
            self._window_key = key
            self._change |= Change.TOPOLOGY
        change, self._change = self._change, Change.NOTHING
        # Not all that sets settings has Blender copy them for the evaluated scene.
        self._settings = preview_settings(depsgraph.scene)
        # As Cycles, a window that only turns keeps what it has culled.
        if not change or change is Change.CAMERA and not culls(depsgraph.scene):
            return
        updated = None if self._touched is None else frozenset(self._touched)
        dicing = dicing_view(context.region, space, context.region_data)
        window = Window(
            lambda item: item.visible_in_viewport_get(space), use_lights=key[0], studio=studio,
            dicing_view=dicing, culling_view=culling_view(view, dicing),
        )
        description = export_scene(
            depsgraph, view_layer=depsgraph.view_layer_eval, cache=self.host.cache, window=window, updated=updated
        )
        description.frame_current = 0.0
        self._touched = set()
        self.host.take(description)

    # What is shown

    def draw(self, engine: bpy.types.RenderEngine, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Send what has changed, draw the newest picture."""
        process = self.host.process
        process.poll()
        try:
            view = self._view(context, depsgraph)
            self._export(context, depsgraph, view)
            mix = shown_mix(depsgraph)
            self._problem = ""
        except ValueError as error:
            self._problem = str(error)
        else:
            self._send(view, mix, depsgraph.scene, context.region_data)
        image = process.read_image()
        if image is not None:
            self._canvas.take(image)
        if not self._canvas.is_empty:
            self._canvas.draw(engine, depsgraph.scene)
        engine.update_stats("", self.text)

    def _view(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> View:
        export = ExportContext(
            depsgraph, depsgraph.scene_eval, depsgraph.view_layer_eval, None, self.host.cache
        )
        return read_view(export, context.region, context.space_data, context.region_data)

    def _send(
        self, view: View, mix: dict[str, Factor], scene: bpy.types.Scene, region_data: bpy.types.RegionView3D
    ) -> None:
        assert self._settings is not None
        size = view.width, view.height
        now = time.monotonic()
        if self._size not in (None, size):
            self._resized = now
        self._size = size
        if now - self._resized < _RESIZE_SECONDS:
            return
        paused = is_paused(scene, region_data)
        self.host.show(view, self._settings, denoises_from=denoises_from(scene), is_paused=paused, mix=mix)

    def tick(self) -> tuple[bool, bool]:
        """Look at the process: whether the window is to be drawn again, and whether more will come soon."""
        process = self.host.process
        before = process.status
        status = process.poll()
        for notice in status.notices:
            if notice not in self._told:
                self._told.add(notice)
                logger.warning("%s: %s; %s", *notice)
        is_resizing = time.monotonic() - self._resized < 2.0 * _RESIZE_SECONDS
        redraw = process.has_image or is_resizing or not same_content(_visible(before), _visible(status))
        return redraw, process.is_waiting or is_resizing

    @property
    def text(self) -> str:
        """What the window says of itself."""
        if self._problem:
            return self._problem
        status = self.host.process.status
        if status.state == DEAD and status.message:
            return f"{status.message}. Any change starts it again"
        if status.state == FAILED:
            return status.message
        parts = [status.message] if status.state != RENDERING or not status.sample else []
        if status.sample:
            parts.append(f"Sample {status.sample}/{status.samples}")
        if status.notices:
            subject, problem, _ = status.notices[0]
            more = len(status.notices) - 1
            parts.append(f"{subject}: {problem}" + (f" (and {more} more: see the terminal)" if more else ""))
        return " | ".join(part for part in parts if part)


def _visible(status: Status) -> tuple[Any, ...]:
    return status.state, status.message, status.sample


def _studio_light(shading: bpy.types.View3DShading) -> StudioLight:
    selected = shading.selected_studio_light
    return StudioLight(
        "" if selected is None else selected.path, shading.studiolight_rotate_z, shading.studiolight_intensity,
        shading.studiolight_background_alpha,
    )
