# SPDX-License-Identifier: GPL-3.0-or-later
"""Does what a command line asks for, on top of the `bpy` module."""

from __future__ import annotations

import contextlib
import os
import signal
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import bpy

from . import checkpoints, console, denoise_over_time, ending_signals, engine, learned_fields, register, sequence
from .cli_arguments import Action, CommandLineError, parse_frame, parse_frames
from .cli_denoising import denoise_animation, denoise_frames
from .cli_mixing import mix_frames
from .declared_settings import parse_setting, setting_owner
from .denoise_sequence import find_frames
from .exr_layers import LayersError
from .frame_files import FrameClaim, frame_paths, is_finished
from .log import log_failure
from .output_files import was_written

#: Names that Blender's -F knows and RNA spells otherwise.
_FORMATS = {"TGA": "TARGA", "RAWTGA": "TARGA_RAW", "JP2": "JPEG2000", "MULTILAYER": "OPEN_EXR_MULTILAYER"}


class RenderFailed(Exception):
    """A frame could not be rendered or saved; the message says why."""


class CommandLineRenderer:
    """Runs actions one after the other, as Blender does with its arguments.

    Attributes
    ----------
    failures : list of str
        What went wrong with frames; rendering goes on with the next frame.
    """

    def __init__(self) -> None:
        self.failures: list[str] = []
        self._threads: int | None = None
        self._pool: Any = None  # of a cluster
        self._wishes = checkpoints.Wishes()
        #: The signal that came first, 0 while none has.
        self.interrupted_by = 0
        register()
        engine.cancel_hooks.append(lambda: self.is_interrupted)

    @property
    def is_interrupted(self) -> bool:
        """Whether no more is to be rendered."""
        return self.interrupted_by != 0

    def interrupt(self, signal_number: int) -> None:
        """Stop the frame being rendered, keep what it has, render no more."""
        self.interrupted_by = self.interrupted_by or signal_number

    def run(self, action: Action) -> None:
        """Do one thing.

        Raises
        ------
        CommandLineError
            Where it cannot be done at all: no such file, scene, engine or format.
        """
        if self._wishes.take(action.name, action.value):
            return
        handler: Callable[[str], None] = getattr(self, "_do_" + action.name.replace("-", "_"))
        handler(action.value)

    # -- settings ---------------------------------------------------------------------------------------------------

    @property
    def _scene(self) -> bpy.types.Scene:
        return bpy.context.scene

    def _do_background(self, _value: str) -> None:
        pass

    def _do_load(self, path: str) -> None:
        file = Path(path).resolve()
        if not file.is_file():
            raise CommandLineError(f"there is no file {path}")
        try:
            bpy.ops.wm.open_mainfile(filepath=str(file), load_ui=False)
        except RuntimeError as error:
            raise CommandLineError(f"Blender cannot read {path}: {_operator_message(error)}") from None

    def _do_engine(self, name: str) -> None:
        if name == "help":
            console.say("\n  ".join(["Render engines:", *_render_engines()]))
            raise SystemExit(0)
        try:
            self._scene.render.engine = name
        except TypeError:
            known = ", ".join(_render_engines())
            raise CommandLineError(f"-E {name}: no such render engine; there are {known}") from None

    def _do_scene(self, name: str) -> None:
        scene = bpy.data.scenes.get(name)
        if scene is None:
            raise CommandLineError(f"-S {name}: no such scene; there are {', '.join(bpy.data.scenes.keys())}")
        bpy.context.window.scene = scene

    def _do_render_output(self, path: str) -> None:
        self._scene.render.filepath = path

    def _do_render_format(self, name: str) -> None:
        identifier = _FORMATS.get(name, name)
        settings = self._scene.render.image_settings
        # From 5.0 the medium comes first and limits the formats.
        media = [item.identifier for item in settings.bl_rna.properties["media_type"].enum_items] if hasattr(
            settings, "media_type"
        ) else [None]
        for medium in media:
            try:
                if medium is not None:
                    settings.media_type = medium
                settings.file_format = identifier
                return
            except TypeError:
                continue
        raise CommandLineError(f"-F {name}: no such format in this Blender; PNG and OPEN_EXR always are")

    def _do_use_extension(self, value: str) -> None:
        self._scene.render.use_file_extension = value == "1"

    def _do_frame_start(self, value: str) -> None:
        start = self._scene.frame_start
        self._scene.frame_start = parse_frame(value, start, start - 1)

    def _do_frame_end(self, value: str) -> None:
        end = self._scene.frame_end
        self._scene.frame_end = parse_frame(value, end, end - 1)

    def _do_frame_jump(self, value: str) -> None:
        self._scene.frame_step = int(value)

    def _do_threads(self, value: str) -> None:
        self._threads = int(value)

    def _do_set(self, text: str) -> None:
        name, value = parse_setting(text)
        setattr(setting_owner(self._scene, name), name, value)

    def _do_field(self, text: str) -> None:
        from engine.guiding.saved.file import FieldFileError

        path = Path(text).resolve()
        ours = self._scene.neuralguide
        if not path.exists() and not ours.save_field:
            raise CommandLineError(
                f"--field {text}: there is no such file; put --set save_field=on before --field to have it made"
            )
        if path.exists():
            try:
                learned_fields.read(path)
            except FieldFileError as error:
                raise CommandLineError(f"--field: {error}") from None
        ours.field_path = str(path)

    def _do_cluster(self, address: str) -> None:
        try:
            from engine.cluster.dask_pool import open_pool
        except ModuleNotFoundError as error:
            raise CommandLineError(
                f"--cluster: Python package {error.name} is missing: install the package distributed"
            ) from None
        from engine.cluster.pool import ClusterError
        from engine.cluster.session import ClusterSession

        self.close()
        try:
            self._pool = pool = open_pool(address, self._threads or 0)
        except ClusterError as error:
            raise CommandLineError(str(error)) from None
        engine.session_maker = lambda settings: ClusterSession(settings, pool)

    def _do_resume(self, _value: str) -> None:
        render = self._scene.render
        render.use_overwrite, render.use_placeholder = False, True

    _do_resume_or_fail = _do_resume

    def _do_denoise_sequence(self, path: str) -> None:
        self._work_on_files("--denoise-sequence", lambda *how: denoise_frames(find_frames(Path(path).resolve()), *how))

    def _do_mix_sequence(self, path: str) -> None:
        self._work_on_files("--mix-sequence", lambda *how: mix_frames(self._scene, Path(path).resolve(), *how))

    def _work_on_files(self, option: str, work: Callable[[int, Callable[[], bool]], str]) -> None:
        try:
            failure = work(self._threads or 0, lambda: self.is_interrupted)
        except (LayersError, OSError) as error:
            raise CommandLineError(f"{option}: {error}") from None
        self.failures += [failure] if failure else []

    def close(self) -> None:
        """Leave the cluster, if there is one."""
        engine.session_maker = None
        if self._pool is not None:
            self._pool.close()
            self._pool = None

    # -- rendering --------------------------------------------------------------------------------------------------

    def _do_render_frame(self, value: str) -> None:
        scene = self._scene
        try:
            frames = parse_frames(value, scene.frame_start, scene.frame_end)
        except CommandLineError as error:
            raise CommandLineError(f"-f {value}: {error}") from None
        for frame in frames:
            self._render([frame])

    def _do_render_anim(self, _value: str) -> None:
        scene = self._scene
        frames = list(range(scene.frame_start, scene.frame_end + 1, scene.frame_step))
        if not frames:
            raise CommandLineError(f"-a: the last frame, {scene.frame_end}, is before the first, {scene.frame_start}")
        failure_count = len(self.failures)
        if scene.render.is_movie_format:
            self._render(frames)
        else:
            # One by one, so that one bad frame does not keep the others from being tried.
            for frame in frames:
                self._render([frame])
        if not denoise_over_time.counts(scene) or self.is_interrupted:
            return
        if len(self.failures) > failure_count:
            console.say("NeuralGuide: frames failed: none is denoised over time")
        elif failure := denoise_animation(scene, frames, self._threads or 0, lambda: self.is_interrupted):
            self.failures.append(failure)

    def _render(self, frames: list[int]) -> None:
        if self.is_interrupted:
            return
        try:
            self._render_or_raise(frames)
        except RenderFailed as failure:
            name = f"frame {frames[0]}" if len(frames) == 1 else f"frames {frames[0]} to {frames[-1]}"
            message = f"{name}: {failure}"
            console.complain(message)
            self.failures.append(message)

    def _render_or_raise(self, frames: list[int]) -> None:
        """Render an animation of these frames, so that Blender names the files as it always does."""
        scene = self._scene
        render = scene.render
        if self._threads is not None:
            render.threads_mode = "FIXED" if self._threads else "AUTO"
            if self._threads:
                render.threads = self._threads
            scene.neuralguide.property_unset("threads")
        if render.is_movie_format:
            self._trace(frames, ())
        elif render.use_overwrite or self._wishes.added or self._wishes.merged:
            # Blender would leave files alone that are there.
            render.use_overwrite = True
            self._trace(frames, frame_paths(render, frames[0]))
        else:
            self._trace_unless_finished(frames[0])

    def _trace_unless_finished(self, frame: int) -> None:
        """Render a frame that nobody has rendered, and that nobody renders now."""
        render = self._scene.render
        paths = frame_paths(render, frame)
        if all(map(is_finished, paths)):
            console.say(f"NeuralGuide: frame {frame} is left as it is: {paths[0]} is there")
            checkpoints.forget(paths[0])
            return
        claim = FrameClaim(paths, makes_placeholders=render.use_placeholder)
        try:
            if not claim.take():
                console.say(f"NeuralGuide: frame {frame} is left to another process, which renders {paths[0]}")
                return
        except OSError as error:
            claim.release()
            raise RenderFailed(f"{error.filename or paths[0]} cannot be written ({error.strerror or error})") from None
        # Blender itself leaves any file alone, one without a picture too. Its placeholders are there by now.
        makes_placeholders = render.use_placeholder
        render.use_overwrite, render.use_placeholder = True, False
        try:
            # It may have been finished between the two looks at it.
            if not all(map(is_finished, paths)):
                self._trace([frame], paths)
        finally:
            render.use_overwrite, render.use_placeholder = False, makes_placeholders
            claim.release()

    def _trace(self, frames: list[int], paths: Sequence[Path]) -> None:
        """Have Blender render; `paths` are the files that there must be then."""
        scene = self._scene
        started = time.time()
        range_before = scene.frame_start, scene.frame_end
        outcome_count = engine.outcome_count()
        sequence.frame_range = range_before
        engine.saves_picture = True
        checkpoints.commanded = kept_frame = checkpoints.begin_frame(scene, paths, self._wishes)
        problem = ""
        status = set()
        try:
            _set_range(scene, frames[0], frames[-1])
            status = bpy.ops.render.render(animation=True, scene=scene.name)
        except RuntimeError as error:
            problem = _operator_message(error)
        finally:
            _set_range(scene, *range_before)
            sequence.frame_range = None
            engine.saves_picture = False
            checkpoints.end_frame()
        outcomes = engine.outcomes_since(outcome_count)
        missing = [path for path in paths if not was_written(path, started)]
        is_cancelled = status != {"FINISHED"} and not self.is_interrupted
        problem = problem or _problem_of(outcomes, missing, is_cancelled=is_cancelled)
        if kept_frame is not None and self.is_interrupted:
            kept_frame.tell_kept(frames[0])
        if not problem:
            if kept_frame is not None and not self.is_interrupted:
                kept_frame.finish()
            return
        has_picture = any(item.has_picture for item in outcomes)
        if self.is_interrupted and not has_picture and all(item.status == "CANCELLED" for item in outcomes):
            console.say(f"NeuralGuide: frame {frames[0]} was interrupted before there was a picture")
            return
        # What has been rendered is not lost because the rest failed, or because Blender could not save it.
        kept = _keep(missing[0]) if has_picture and missing else ""
        raise RenderFailed(problem + kept)


def _problem_of(outcomes: list[engine.Outcome], missing: list[Path], *, is_cancelled: bool) -> str:
    """What went wrong by the word of the engine and by the files that are not there, '' where nothing did."""
    if is_cancelled:
        return "Blender cancelled the render"
    if bpy.context.scene.render.engine == engine.NeuralGuideRenderEngine.bl_idname:
        if not outcomes:
            return "no view layer was rendered; is any enabled?"
        failed = [f"{item.view_layer}: {item.message}" for item in outcomes if item.status == "FAILED"]
        if failed:
            return "; ".join(failed)
    return f"{missing[0]} was not written: is the folder writable, is the disk full?" if missing else ""


def _set_range(scene: bpy.types.Scene, start: int, end: int) -> None:
    """Set first and last frame; setting one pushes the other along."""
    scene.frame_end = end
    scene.frame_start = start
    scene.frame_end = end


def _keep(path: Path) -> str:
    """Save the picture in the folder for temporary files instead; returns a sentence that says so, '' if in vain."""
    started = time.time()
    try:
        # Others write there too, and must not know the name before.
        descriptor, name = tempfile.mkstemp(prefix="neuralguide_", suffix=f"_{path.name}")
    except OSError:
        return ""
    os.close(descriptor)
    rescue = Path(name)
    with contextlib.suppress(KeyError, RuntimeError, OSError):
        bpy.data.images["Render Result"].save_render(name, scene=bpy.context.scene)
        if was_written(rescue, started):
            return f" The picture is kept in {rescue}"
    with contextlib.suppress(OSError):
        rescue.unlink(missing_ok=True)
    return ""


def _operator_message(error: RuntimeError) -> str:
    """What an operator reported, without the prefix."""
    lines = [line.removeprefix("Error: ").strip() for line in str(error).splitlines()]
    return " ".join(dict.fromkeys(line for line in lines if line)) or "Blender gave no reason"


def _render_engines() -> list[str]:
    """Identifiers of engines; Blender lists its own only when refusing an unknown one."""
    try:
        bpy.context.scene.render.engine = "?"
    except TypeError as error:  # enum "?" not found in ('BLENDER_EEVEE', ...)
        return sorted(str(error).partition("not found in")[2].split("'")[1::2])
    return []


def run(actions: list[Action]) -> int:
    """Run actions.

    Returns
    -------
    int
        The exit code: 0, 1 where a frame failed, 2 where the command line asks for what is not there; after a signal
        128 and its number.
    """
    renderer = CommandLineRenderer()
    previous = ending_signals.handle(lambda number, _frame: renderer.interrupt(number))
    try:
        for action in actions:
            renderer.run(action)
    except CommandLineError as error:
        console.complain(str(error))
        return 2
    except Exception as error:
        path = log_failure("internal error of the command line")
        console.complain(f"internal error: {error!r}" + (f" (details in {path})" if path is not None else ""))
        return 1
    finally:
        renderer.close()
        for number, handler in previous.items():
            signal.signal(number, handler)
    if renderer.failures:
        console.complain(f"{len(renderer.failures)} frame(s) failed")
        return 1
    return 128 + renderer.interrupted_by if renderer.is_interrupted else 0
