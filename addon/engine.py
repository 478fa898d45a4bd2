# SPDX-License-Identifier: GPL-3.0-or-later
"""The render engine as Blender sees it: hooks in, pixels out."""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import math
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import bpy

from . import (
    denoise_over_time,
    figures,
    freestyle,
    kept_frames,
    light_mix_picture,
    material_preview,
    passes,
    sequence,
)
from .app_handlers import add_handlers, remove_handlers
from .baking import BakeHook
from .failures import what_failed
from .frame_parts import is_only_picture, place
from .learned_fields import FieldPlan
from .log import log_failure, logger
from .properties import render_settings
from .shared_settings import layer_is_denoised, layer_samples
from .shown_notices import forget_notices, show_notices
from .shown_progress import shown_progress
from .unsupported_settings import unsupported_settings
from .viewport import windows
from .waiting_picture import WaitingPicture

if TYPE_CHECKING:
    from engine.scene.description import Notice, SceneDescription

#: Extra reasons to stop, beside Esc: Ctrl-C of the command line, tests.
cancel_hooks: list[Callable[[], bool]] = []

#: Makes the session that renders, of settings; None: `engine.render.session.Session`, which traces in this process.
session_maker: Callable[[Any], Any] | None = None


@dataclasses.dataclass(frozen=True)
class Outcome:
    """How the render of one view layer at one frame ended; `status` is 'FINISHED', 'CANCELLED' or 'FAILED'.

    `first_image` is when the first picture was shown, by `time.monotonic`; nan if none was. `notices` are those of the
    settings and of the scene. `has_picture`: whether Blender has got what was rendered, which may be a part of it.
    `resumed`: samples a pixel that were taken up from a checkpoint.
    """

    scene: str
    view_layer: str
    frame: int
    status: str
    message: str = ""
    report: Any = None
    first_image: float = math.nan
    notices: tuple[Notice, ...] = ()
    has_picture: bool = False
    resumed: int = 0


#: Whether Blender saves the picture of the render in progress, so that it has to be told if there is none.
saves_picture = False


class _NothingRendered(Exception):
    """A render was cancelled before its first sample."""


#: The latest outcomes, oldest first. Blender's operator cannot tell: it says FINISHED when an engine raised.
outcomes: deque[Outcome] = deque(maxlen=4096)
_outcome_count = 0


def outcome_count() -> int:
    """How many outcomes there have been, forgotten ones included."""
    return _outcome_count


def outcomes_since(count: int) -> list[Outcome]:
    """Outcomes noted after `outcome_count()` was `count`."""
    return list(outcomes)[len(outcomes) - min(_outcome_count - count, len(outcomes)) :]


@bpy.app.handlers.persistent
def forget_outcomes(*_args: Any) -> None:
    """Forget what renders came to: a scene of another file may have the same name."""
    outcomes.clear()


class NeuralGuideRenderEngine(BakeHook, bpy.types.RenderEngine):
    """Final renders, previews of materials, and windows in rendered shading.

    For a render Blender calls `update_render_passes`, then `update` and `render` for every view layer, then
    `render_frame_finish`. The same instance comes back for the next frame where "Persistent Data" is on: what it holds
    then saves work.
    A window has an instance of its own, whose `view_update` and `view_draw` are called.
    """

    bl_idname = "NEURALGUIDE"
    bl_label = "NeuralGuide"
    bl_use_postprocess = True
    bl_use_shading_nodes_custom = False
    bl_use_eevee_viewport = True
    bl_use_preview = True
    # Lines are rendered here too (`freestyle`), as by Cycles; by EEVEE they would take half a minute without a GPU.
    bl_use_custom_freestyle = True

    # Class attributes rather than `__init__`, whose signature differs between versions of Blender; and no types here
    # but plain ones, since Blender 3.4 evaluates the annotations of every class it registers.
    #: Whether a bar stands where there is no picture yet: where somebody looks.
    shows_waiting: Any = not bpy.app.background

    _session: Any = None
    _settings: Any = None  # RenderSettings of the layer that `update` exported last
    _export_cache: Any = None
    _plan: Any = None  # SequencePlan of what `update` exported, None without
    _fields: Any = None  # FieldPlan of what `update` exported
    _pending: Any = None  # list of (view name, SceneDescription), None if there is nothing to render
    _notices: Any = ()  # what settings and passes ask for in vain
    _draws_strokes = False  # whether what `update` exported are Freestyle's lines
    _layers_done = 0
    _started = 0.0
    _first_image = math.nan
    _has_picture = False  # of the layer that `update` exported last
    _view: Any = None  # of a window in rendered shading

    # -- hooks ------------------------------------------------------------------------------------------------------

    def update_render_passes(self, scene: bpy.types.Scene, view_layer: bpy.types.ViewLayer) -> None:
        """Tell Blender which passes there will be; without it only Combined exists."""
        self._has_passes = True
        for item in passes.requested_passes(scene, view_layer):
            self.register_pass(scene, view_layer, item.blender_name, len(item.channels), item.channels, item.kind)
        if freestyle.has_pass(scene, view_layer):
            # Blender itself fills it.
            self.register_pass(scene, view_layer, freestyle.PASS_NAME, 4, "RGBA", "COLOR")

    def update(self, _data: bpy.types.BlendData, depsgraph: bpy.types.Depsgraph) -> None:
        """Export the view layer; Blender's data must not be read later than this."""
        self._pending = self._plan = None
        self._started = time.monotonic()
        self._first_image = math.nan
        self._has_picture = False
        if self._is_bake:
            # `bake` exports what it needs.
            return
        self._guard(depsgraph, "exporting the scene", self._export_preview if self.is_preview else self._export)

    def render(self, depsgraph: bpy.types.Depsgraph) -> None:
        """Trace what `update` exported."""
        if self._pending is not None:
            with kept_frames.delaying_end(depsgraph.scene):
                self._guard(depsgraph, "rendering", self._render_preview if self.is_preview else self._render)
        self._pending = None
        self._layers_done += 1

    def render_frame_finish(self) -> None:
        """All view layers of the frame are done."""
        self._layers_done = 0

    def view_update(self, _context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Something has changed in the scene that a window shows."""
        self._guard_view(lambda view: view.update(depsgraph))

    def view_draw(self, context: bpy.types.Context, depsgraph: bpy.types.Depsgraph) -> None:
        """Draw what the window's process has rendered."""
        self._guard_view(lambda view: view.draw(self, context, depsgraph))
        windows.wake()

    def view_pause(self, _context: bpy.types.Context) -> None:
        """A window's pause button was pressed; without this method Blender 5.3 shows none."""
        self.tag_redraw()

    def view_resume(self, _context: bpy.types.Context) -> None:
        """It was released."""
        self.tag_redraw()

    # -- the work ---------------------------------------------------------------------------------------------------

    def _export(self, depsgraph: bpy.types.Depsgraph) -> None:
        from engine.guiding.models import training_process
        from engine.scene.description import Notice
        from engine.scene.limits import check_frame, texture_memory

        from .export import ExportCache, ExportCancelled, export_scene

        scene = depsgraph.scene_eval
        settings = render_settings(scene)
        layer = depsgraph.view_layer_eval
        self._settings = settings = dataclasses.replace(
            settings,
            samples=layer_samples(scene, layer, settings.samples),
            use_denoising=layer_is_denoised(scene, layer, settings.use_denoising),
        )
        self._draws_strokes = freestyle.is_of_strokes(depsgraph.scene)
        if self._draws_strokes:
            self._settings = settings = freestyle.stroke_settings(settings)
        self._fields = FieldPlan(depsgraph, settings)
        if settings.trains_network and not scene.neuralguide.sequence_field:
            # It gets ready while the scene is exported, and stays for the renders after this one.
            training_process.stand_by(settings.training_device)
        if self._export_cache is None:
            self._export_cache = ExportCache()
        views = [view.name for view in scene.render.views if view.use] if scene.render.use_multiview else [""]
        if not bpy.app.background:
            self.update_stats("", f"{place(depsgraph)} | Exporting the scene")
        pending = []
        try:
            for view in views:
                if view:
                    self.active_view_set(view)
                description = export_scene(
                    depsgraph,
                    engine=self,
                    view_layer=depsgraph.view_layer_eval,
                    cache=self._export_cache,
                    should_cancel=self._should_cancel,
                    texture_memory=texture_memory(settings.texture_memory),
                )
                check_frame(description.frame)  # before Blender makes room for the picture
                pending.append((view, description))
            if views[0]:
                self.active_view_set(views[0])
            if not self._draws_strokes:
                self._plan = sequence.make_plan(
                    depsgraph,
                    settings,
                    pending[0][1],
                    engine=self,
                    cache=self._export_cache,
                    should_cancel=self._should_cancel,
                )
        except ExportCancelled:
            self._note_nothing(depsgraph)
            return
        self._pending = pending
        if self._draws_strokes:
            return
        self._notices = unsupported_settings(scene, layer) + denoise_over_time.notices(scene)
        if self._plan is not None:
            self._notices += self._plan.notices
        missing = passes.unsupported_passes(layer)
        if missing:
            problem = f"no passes {', '.join(missing)}"
            self._notices.append(Notice(f"View layer {layer.name}", problem, "they are left out"))
        self._show(self._notices)

    def _export_preview(self, depsgraph: bpy.types.Depsgraph) -> None:
        description = material_preview.export_preview(self, depsgraph)
        self._pending = None if description is None else [("", description)]

    def _render_preview(self, depsgraph: bpy.types.Depsgraph) -> None:
        ((_, description),) = self._pending
        material_preview.render_preview(self, depsgraph, description)

    def _render(self, depsgraph: bpy.types.Depsgraph) -> None:
        from engine.render.session import LoadCancelled, Session

        if self._session is None:
            self._session = (session_maker or Session)(self._settings)
        elif self._session.settings != self._settings:
            # Built geometry stays; only what the settings touch is built anew.
            self._session.settings = self._settings
        try:
            if self._plan is not None and self._plan.must_train:
                with self._progress(depsgraph) as on_progress:
                    self._show(self._plan.train(on_progress, self._should_cancel))
            for view, description in self._pending:
                if view:
                    self.active_view_set(view)
                self._render_view(depsgraph, view, description)
        except (LoadCancelled, _NothingRendered):
            self._note_nothing(depsgraph)

    def _progress(
        self, depsgraph: bpy.types.Depsgraph, view: str = "", waiting: WaitingPicture | None = None
    ) -> contextlib.AbstractContextManager[Callable[[Any], None]]:
        shown = freestyle.PASS_NAME if self._draws_strokes else depsgraph.view_layer_eval.name
        return shown_progress(self, depsgraph, shown, self._layers_done, view, waiting)

    def _render_view(self, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription) -> None:
        layer_name = depsgraph.view_layer_eval.name
        x0, y0, x1, y1 = description.frame.region
        target = self.begin_result(0, 0, x1 - x0, y1 - y0, layer=layer_name, view=view)
        keep = False
        cancelled = False
        try:
            if (target.resolution_x, target.resolution_y) != (x1 - x0, y1 - y0):
                # Blender rounds borders its own way, and its word counts.
                description.frame.region = (x0, y0, x0 + target.resolution_x, y0 + target.resolution_y)
            requested = passes.requested_passes(depsgraph.scene_eval, depsgraph.view_layer_eval)
            wanted = {item.name: item for item in requested}
            write = functools.partial(self._write, target.layers[0], view, wanted)

            def show_waiting(picture: Any) -> None:
                passes.write_layer(target.layers[0], view, {"Combined": passes.COMBINED}, {"Combined": picture})
                self.update_result(target)

            height, width = target.resolution_y, target.resolution_x
            waiting = WaitingPicture(show_waiting, height, width) if self.shows_waiting else None
            mix = light_mix_picture.RenderedMix(self, depsgraph, view, description)

            def on_image(images: Any) -> None:
                nonlocal keep
                if waiting is not None:
                    waiting.end()
                mix.stream(images, write)
                keep = self._has_picture = True
                self.update_result(target)
                self._note_image()

            source = None if self._plan is None else self._plan.source(description)
            with self._progress(depsgraph, view, waiting) as on_progress:
                keeps_meshes = self._plan is not None or not is_only_picture(depsgraph.scene)
                if not keeps_meshes:
                    self._export_cache = None
                kept_frames.begin_view(
                    self, self._session, self._settings, depsgraph, view, description, self._show,
                    is_wanted=not self._draws_strokes, keeps_meshes=keeps_meshes,
                )
                notices = self._session.load(
                    description, on_progress=on_progress, should_cancel=self._should_cancel, keeps_meshes=keeps_meshes
                )
                self._show(notices)
                start, notices = self._fields.start(self._session)
                self._show(notices)
                result = self._session.render(
                    on_progress=on_progress, on_image=on_image, should_cancel=self._should_cancel, passes=set(wanted),
                    source=source, start=start, keep=self._fields.keeps, one_by_one=True,
                )  # fmt: skip
            learned, report = result.learned, result.report
            cancelled = report.cancelled
            if cancelled and not report.sample_count:
                raise _NothingRendered
            kept = mix.note(result.passes, write)
            # With it the film goes, before Blender makes a copy of its own.
            del result
            keep = self._has_picture = True
            self._note_image()
        finally:
            # A cancelled result is thrown away unless merged; so is one that an error left half done.
            self.end_result(target, cancel=cancelled or not keep, do_merge_results=keep)
        if self._draws_strokes:
            self._show(report.notices)
            return
        self._note(depsgraph, "CANCELLED" if cancelled else "FINISHED", report=report)
        # The picture is Blender's now: nothing that fails from here on may cost it.
        for doing, work in (
            ("keeping what was learned", lambda: self._show(self._fields.take(learned))),
            ("saying what is kept of it", lambda: self._note_kept(depsgraph, report)),
            ("saying how the render went", lambda: self._report_result(depsgraph, report)),
            ("keeping light groups", lambda: mix.keep(kept)),
            ("naming what is in mattes", lambda: figures.stamp_mattes(self, depsgraph.view_layer_eval, description)),
        ):
            self._attempt(doing, work, "the picture is whole")

    def _write(self, layer: bpy.types.RenderLayer, view: str, wanted: dict[str, Any], images: Any) -> None:
        """Give Blender all passes; one that fails must not cost the picture, which comes first."""
        for name, item in wanted.items():
            if name == passes.COMBINED.name:
                passes.write_layer(layer, view, {name: item}, images)
            else:
                self._attempt(
                    f"making pass {item.blender_name}",
                    lambda one={name: item}: passes.write_layer(layer, view, one, images),  # type: ignore[misc]
                    "it is black or unfinished",
                )

    # -- telling the user ---------------------------------------------------------------------------------------------

    def _guard(
        self,
        depsgraph: bpy.types.Depsgraph,
        doing: str,
        work: Callable[[bpy.types.Depsgraph], None],
    ) -> None:
        """Run `work`; Blender swallows what a hook raises, so say it in words and remember it."""
        try:
            work(depsgraph)
            return
        except Exception as error:
            message = what_failed(error, doing)
        self._pending = None
        self._note(depsgraph, "FAILED", message)
        if bpy.app.background:
            logger.error(message)
        self.report({"ERROR"}, message)

    def _attempt(self, doing: str, work: Callable[[], None], fallback: str) -> None:
        """Run what the picture does not depend on: if it fails that is said, and the render goes on."""
        from engine.scene.description import Notice

        try:
            work()
        except Exception as error:
            path = log_failure(f"{doing} failed")
            problem = f"{doing} failed: {type(error).__name__}: {error}"
            details = f" (details in {path})" if path is not None else ""
            self._show([Notice("Render", problem, fallback + details)])

    def _guard_view(self, work: Callable[[Any], None]) -> None:
        """Run `work` on the window's view; what it raises is shown in the window."""
        try:
            if self._view is None:
                self._view = windows.open_window(self)
            work(self._view)
        except Exception as error:
            message = f"internal error in the viewport: {type(error).__name__}: {error}"
            path = log_failure(message)
            self.update_stats("", f"{message} (details in {path})" if path is not None else message)

    def _note(self, depsgraph: bpy.types.Depsgraph, status: str, message: str = "", report: Any = None) -> None:
        global _outcome_count
        if self.is_preview:
            return
        scene = depsgraph.scene
        name = depsgraph.view_layer_eval.name
        notices = (*self._notices, *(report.notices if report is not None else ()))
        kept = None if self._session is None else self._session.checkpointing
        outcomes.append(
            Outcome(
                scene.name, name, scene.frame_current, status, message, report, self._first_image, notices,
                self._has_picture, 0 if kept is None else kept.resumed,
            )
        )
        _outcome_count += 1

    def _note_nothing(self, depsgraph: bpy.types.Depsgraph) -> None:
        """The render was cancelled before there was a picture of the layer."""
        from engine.render.report import ENDINGS

        if self._draws_strokes:
            # The picture is there, without lines.
            return
        self._note(depsgraph, "CANCELLED")
        if self._layers_done == 0 and not self._has_picture:
            if saves_picture and not self.test_break():
                # Blender does not know, and would crash.
                self.report({"ERROR"}, "the render was cancelled before there was a picture")
            return
        # Other layers or views are there: the file is to say that it lacks one.
        field = f"neuralguide.{depsgraph.view_layer_eval.name}.ended_by"
        self._attempt(
            "marking the picture as unfinished",
            lambda: self.get_result().stamp_data_add_field(field, ENDINGS["CANCEL"]), "the file does not say so",
        )

    def _note_image(self) -> None:
        if math.isnan(self._first_image):
            self._first_image = time.monotonic()

    def _show(self, notices: list[Notice]) -> None:
        show_notices(self, notices)

    def _report_result(self, depsgraph: bpy.types.Depsgraph, report: Any) -> None:
        """Put figures into the log, the file's metadata and Blender's memory display."""
        self._show(report.notices)
        layer_name = depsgraph.view_layer_eval.name
        figures.log_figures(layer_name, depsgraph.scene.frame_current, time.monotonic() - self._started, report)
        if report.reject_count:
            text = f"{report.reject_count} samples were NaN or infinite and were left out"
            logger.warning(text)
            self.report({"WARNING"}, text)
        megabytes = report.peak_memory / 2**20
        self.update_memory_stats(memory_used=megabytes, memory_peak=megabytes)
        figures.stamp_figures(self, layer_name, report, [*self._notices, *report.notices])

    def _note_kept(self, depsgraph: bpy.types.Depsgraph, report: Any) -> None:
        kept_frames.note_view(self, self._session, depsgraph.scene, report, self._show)

    def _should_cancel(self) -> bool:
        return self.test_break() or kept_frames.is_asked_to_end() or any(hook() for hook in cancel_hooks)


def _handlers() -> list[tuple[list[Any], Any]]:
    return [(bpy.app.handlers.render_init, forget_notices), (bpy.app.handlers.load_pre, forget_outcomes)]


def register() -> None:
    """Make the engine selectable."""
    bpy.utils.register_class(NeuralGuideRenderEngine)
    add_handlers(_handlers())


def unregister() -> None:
    """Take it away."""
    from engine.guiding.models import training_process

    training_process.dismiss()
    material_preview.forget_session()
    remove_handlers(_handlers())
    forget_outcomes()
    bpy.utils.unregister_class(NeuralGuideRenderEngine)
