# SPDX-License-Identifier: GPL-3.0-or-later
"""Pictures of materials, worlds and lamps in the properties editor and in lists: Blender's own little scenes."""

from __future__ import annotations

import contextlib
import dataclasses
import threading
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

from . import passes
from .properties import render_settings

if TYPE_CHECKING:
    import bpy

    from engine.render.session import Session
    from engine.scene.description import SceneDescription
    from engine.settings import RenderSettings

#: Paths a pixel. Previews are small and have lamps that light sampling finds, so that nothing is learned.
_SAMPLES = 64

#: Kept for the next preview, whose kernels are the same; whoever has the lock uses it.
_session: Session | None = None
_lock = threading.Lock()


def preview_settings(scene: bpy.types.Scene) -> RenderSettings:
    """What a preview is rendered by: the little scene's settings, within what a preview may take."""
    settings = render_settings(scene)
    return dataclasses.replace(
        settings, samples=min(settings.samples, _SAMPLES), time_limit=0.0, strata=0, guiding_method="OFF",
        radiance_cache="OFF", spectral="OFF", caustics="PATHS",
    )  # fmt: skip


def export_preview(engine: Any, depsgraph: bpy.types.Depsgraph) -> SceneDescription | None:
    """The little scene; None if the user has gone on meanwhile."""
    from .export import ExportCache, ExportCancelled, export_scene

    try:
        return export_scene(
            depsgraph, engine=engine, view_layer=depsgraph.view_layer_eval, cache=ExportCache(),
            should_cancel=engine.test_break,
        )  # fmt: skip
    except ExportCancelled:
        return None


def render_preview(engine: Any, depsgraph: bpy.types.Depsgraph, description: SceneDescription) -> None:
    """Render what `export_preview` returned into the engine's result, unless the user goes on meanwhile."""
    from engine.render.session import LoadCancelled

    x0, y0, x1, y1 = description.frame.region
    target = engine.begin_result(0, 0, x1 - x0, y1 - y0, layer=depsgraph.view_layer_eval.name)
    is_whole = False

    def on_image(images: Any) -> None:
        passes.write_layer(target.layers[0], "", {"Combined": passes.COMBINED}, images)
        engine.update_result(target)

    try:
        with _turn(engine) as session:
            if session is not None:
                session.settings = preview_settings(depsgraph.scene_eval)
                session.load(description, should_cancel=engine.test_break)
                result = session.render(on_image=on_image, should_cancel=engine.test_break)
                on_image(result.passes)
                is_whole = not result.report.cancelled
    except LoadCancelled:
        pass
    finally:
        engine.end_result(target, cancel=not is_whole, do_merge_results=is_whole)


@contextlib.contextmanager
def _turn(engine: Any) -> Iterator[Session | None]:
    """The session of previews for one of them at a time; None for those that are cancelled while they wait."""
    global _session
    while not _lock.acquire(timeout=0.1):
        if engine.test_break():
            yield None
            return
    try:
        if _session is None:
            from engine.render.session import Session
            from engine.settings import RenderSettings

            _session = Session(RenderSettings())
        yield _session
    finally:
        _lock.release()


def forget_session() -> None:
    """Let go of what previews have kept."""
    global _session
    _session = None
