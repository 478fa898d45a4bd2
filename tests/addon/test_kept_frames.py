# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames that Blender renders, cancelled or cut off: rendered again they go on, and nothing else is left of them."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import OpenEXR
import pytest

from engine.processes.file_locks import FileHold
from engine.scene.description import Notice
from tests.helpers.command_line import names, run_here
from tests.helpers.small_scenes import pit_scene
from tests.helpers.waiting import wait_until

ROOT = Path(__file__).resolve().parents[2]
posix = pytest.mark.skipif(os.name != "posix", reason="signals and locks")
#: A second of work, by one thread.
SAMPLES = 800
#: Renders frame 1 of a file as `blender -b scene.blend -f 1` does, with a checkpoint many times a second.
BLENDER = """
import sys
sys.path.insert(0, {root!r})
import bpy
import addon
addon.register()
from addon import checkpoints
checkpoints.INTERVAL = 0.05
bpy.ops.wm.open_mainfile(filepath={file!r})
scene = bpy.context.scene
scene.frame_start = scene.frame_end = 1
bpy.ops.render.render(animation=True)
"""


def pixels(path: Path) -> Any:
    with OpenEXR.File(str(path)) as file:
        return np.array(file.channels()["RGBA"].pixels)


class Window:
    """Renders a file's scene as F12 and Render Animation do, and cancels as Esc does.

    Files are to be there as soon as anything is rendered, unless `interval` says otherwise.
    """

    def __init__(self, blend_file: Path, blender: Any, monkeypatch: Any) -> None:
        from addon import checkpoints, engine

        self.folder, self.scene = blend_file.parent, blender.context.scene
        self._operator, self._monkeypatch, self._engine = blender.ops.render.render, monkeypatch, engine
        monkeypatch.setattr(checkpoints, "INTERVAL", 0.02)
        render, ours = self.scene.render, self.scene.neuralguide
        render.engine, render.filepath = "NEURALGUIDE", "//x_"
        render.image_settings.file_format = "OPEN_EXR"
        render.resolution_x, render.resolution_y, render.resolution_percentage = 64, 48, 100
        ours.threads, ours.samples, ours.guiding_method, ours.radiance_cache = 1, SAMPLES, "OFF", "OFF"
        ours.use_adaptive_sampling = ours.use_denoising = False
        self.scene.frame_start, self.scene.frame_end = 1, 2
        self.scene.frame_set(1)

    @property
    def outcomes(self) -> list[Any]:
        """How renders went."""
        return list(self._engine.outcomes)

    @property
    def last(self) -> Any:
        """How the last one did."""
        return self.outcomes[-1]

    def render(self, **how: Any) -> Any:
        """To its end."""
        self._operator(**how)
        return self.last

    def cancel(self, kept: str = "x_0001.exr.ngcheckpoint", **how: Any) -> Any:
        """Until a file is there; '': until there is a picture."""
        has_picture = []

        def is_there() -> bool:
            return (self.folder / kept).exists() if kept else bool(has_picture)

        with self._monkeypatch.context() as patch:
            real = self._engine.passes.write_layer
            patch.setattr(self._engine.passes, "write_layer", lambda *args: (has_picture.append(1), real(*args)))
            # As the user's Esc, of which Blender tells the engine, and heeds itself.
            patch.setattr(self._engine, "cancel_hooks", [is_there])
            self._operator(**how)
        return self.last

    def picture(self) -> Any:
        """What the last render has left."""
        import bpy

        path = self.folder / "shown.exr"
        bpy.data.images["Render Result"].save_render(str(path), scene=self.scene)
        found = pixels(path)
        path.unlink()
        return found


@pytest.fixture
def window(blend_file: Path, blender: Any, monkeypatch: Any) -> Window:
    return Window(blend_file, blender, monkeypatch)


def test_a_cancelled_still_goes_on_to_the_same_bits(window: Window, capfd: Any) -> None:
    from addon import kept_frames, last_render

    window.scene.neuralguide.keep_unfinished = False
    assert window.render().status == "FINISHED" and names(window.folder) == []
    whole = window.picture()
    window.scene.neuralguide.keep_unfinished = True
    cancelled = window.cancel()
    assert cancelled.status == "CANCELLED" and names(window.folder) == ["x_0001.exr.ngcheckpoint"]
    kept = kept_frames.kept_of(window.scene)
    assert kept is not None and kept == kept_frames.Kept(1, window.folder / "x_0001.exr.ngcheckpoint")
    assert f"frame 1 is kept as far as it came, in {kept.path}" in capfd.readouterr().err
    went_on = window.render()
    assert went_on.status == "FINISHED" and 0 < went_on.resumed < SAMPLES
    assert "frame 1 goes on from" in capfd.readouterr().err
    assert np.array_equal(window.picture(), whole)
    assert names(window.folder) == [] and kept_frames.kept_of(window.scene) is None
    assert last_render.last_outcomes(window.scene)[0].resumed == went_on.resumed


def test_what_is_cancelled_while_it_is_denoised_is_kept(window: Window, monkeypatch: Any) -> None:
    from engine.render.session import Denoising

    window.scene.neuralguide.use_denoising = True
    with monkeypatch.context() as patch:
        patch.setattr(Denoising, "run", lambda *_args: False)
        assert window.render().status == "CANCELLED"
    assert names(window.folder) == ["x_0001.exr.ngcheckpoint"]
    assert window.render().resumed == SAMPLES and names(window.folder) == []


@pytest.mark.parametrize("is_persistent", [False, True])
def test_a_cancelled_animation_goes_on_with_its_frame(window: Window, is_persistent: bool) -> None:
    """Blender itself cancels at the second frame, so that it saves nothing of that."""
    render = window.scene.render
    render.use_persistent_data, render.use_overwrite, render.use_placeholder = is_persistent, False, False
    window.cancel("x_0002.exr.ngcheckpoint", animation=True)
    kept = ["x_0001.exr", "x_0002.exr.ngcheckpoint"]
    # Hooks of ours cancel a frame, and Blender saves what there is of it.
    (window.folder / "x_0002.exr").unlink(missing_ok=True)
    assert names(window.folder) == kept
    assert window.render(animation=True).resumed > 0
    assert names(window.folder) == ["x_0001.exr", "x_0002.exr"]


def test_short_renders_leave_nothing(window: Window, monkeypatch: Any) -> None:
    from addon import checkpoints

    monkeypatch.setattr(checkpoints, "INTERVAL", 60.0)
    assert window.cancel("").status == "CANCELLED" and names(window.folder) == []
    window.scene.view_layers.new("Second")
    window.scene.neuralguide.samples = 8
    assert window.render().status == "FINISHED" and names(window.folder) == []


def test_what_does_not_fit_begins_anew_and_may_be_thrown_away(window: Window, blender: Any, monkeypatch: Any) -> None:
    from addon import checkpoints

    window.cancel()
    kept = (window.folder / "x_0001.exr.ngcheckpoint").read_bytes()
    monkeypatch.setattr(checkpoints, "INTERVAL", 60.0)
    window.scene.render.resolution_percentage, window.scene.neuralguide.samples = 50, 8
    small = window.render()
    assert small.resumed == 0 and (window.folder / "x_0001.exr.ngcheckpoint").read_bytes() == kept
    window.scene.render.resolution_percentage, window.scene.neuralguide.samples = 100, SAMPLES
    assert window.render().resumed > 0 and names(window.folder) == []
    monkeypatch.setattr(checkpoints, "INTERVAL", 0.02)
    window.cancel()
    assert blender.ops.neuralguide.discard_unfinished() == {"FINISHED"}
    assert names(window.folder) == [] and blender.ops.neuralguide.discard_unfinished() == {"FINISHED"}


def test_a_border_has_a_file_of_its_own(window: Window) -> None:
    render = window.scene.render
    window.cancel()
    render.use_border, render.border_max_x = True, 0.5
    window.cancel("x_0001.exr.border.ngcheckpoint")
    assert window.render().resumed > 0
    render.use_border = False
    assert names(window.folder) == ["x_0001.exr.ngcheckpoint"] and window.render().resumed > 0


def test_layers_that_were_finished_are_not_rendered_again(window: Window) -> None:
    window.scene.view_layers.new("Second")
    window.cancel("x_0001.exr.1.ngcheckpoint")
    assert names(window.folder) == ["x_0001.exr.0.ngcheckpoint", "x_0001.exr.1.ngcheckpoint"]
    assert window.render().resumed > 0
    first, second = window.outcomes[-2:]
    assert first.resumed == SAMPLES and 0 < second.resumed < SAMPLES and names(window.folder) == []


@posix
def test_a_frame_that_another_process_renders_is_left_to_it(window: Window, blender: Any, capfd: Any) -> None:
    window.cancel()
    path = window.folder / "x_0001.exr.ngcheckpoint"
    before, other = path.read_bytes(), FileHold()
    assert other.take(path)
    assert window.render().resumed == 0
    assert "is of another process, which renders the same; this render is not kept" in capfd.readouterr().err
    with pytest.raises(RuntimeError, match="another process uses it"):
        blender.ops.neuralguide.discard_unfinished()
    assert path.read_bytes() == before
    other.release()
    assert window.render().resumed > 0 and names(window.folder) == []


def test_a_folder_that_takes_no_file_costs_no_picture(window: Window, monkeypatch: Any, capfd: Any) -> None:
    from engine.render import checkpointing

    monkeypatch.setattr(checkpointing.shutil, "disk_usage", lambda _folder: SimpleNamespace(free=1000))
    assert window.render().status == "FINISHED" and names(window.folder) == []
    said = capfd.readouterr().err
    assert "x_0001.exr.ngcheckpoint cannot be written (it needs" in said and "the render goes on without" in said


def test_films_of_finished_frames_are_kept_where_that_is_asked(window: Window, blender: Any, monkeypatch: Any) -> None:
    window.scene.neuralguide.keep_film, window.scene.neuralguide.samples = True, 12
    assert window.render().status == "FINISHED" and names(window.folder) == ["x_0001.exr.ngfilm"]
    blender.ops.wm.save_mainfile()
    line = [str(window.folder / "scene.blend"), "-o", "//x_", "--add-samples", "20", "-f", "1"]
    assert run_here(monkeypatch, *line) == 0 and window.last.report.sample_count == 32


def test_the_command_line_does_as_the_scene_says(blend_file: Path, blender: Any, monkeypatch: Any) -> None:
    from addon.checkpoints import Wishes

    ours = blender.context.scene.neuralguide
    assert Wishes().of_scene(blender.context.scene).interval == 60.0
    ours.keep_unfinished = False
    assert not Wishes().of_scene(blender.context.scene).is_any
    assert Wishes(interval=5.0).of_scene(blender.context.scene).interval == 5.0


def test_where_a_frame_is_kept(window: Window, blender: Any, tmp_path: Path) -> None:
    from addon.kept_frames import kept_path

    scene, render = window.scene, window.scene.render
    temporary = Path(blender.app.tempdir).parent

    def found(*, is_animation: bool = False) -> Path | None:
        return kept_path(scene, is_animation=is_animation)

    assert found() == found(is_animation=True) == tmp_path / "x_0001.exr"
    render.filepath = "//not there/x_"
    assert found() == temporary / "scene_x_0001.exr" and found(is_animation=True) == tmp_path / "not there/x_0001.exr"
    render.filepath = f"{temporary}/"
    assert found() == found(is_animation=True) == temporary / "scene_0001.exr"
    if blender.app.version >= (5, 0):
        render.filepath = "//{nothing}_"
        assert found() == temporary / "scene_0001"
    render.filepath = "//x_"
    blender.ops.wm.read_homefile(use_empty=True)
    scene = blender.context.scene
    scene.render.filepath, scene.render.image_settings.file_format = "//x_", "OPEN_EXR"
    assert found() == temporary / "unsaved_x_0001.exr"


def test_scenes_that_are_parts_of_a_picture_have_files_of_their_own(window: Window, blender: Any) -> None:
    from addon.checkpoints import FrameCheckpoints, Wishes

    frame = FrameCheckpoints(window.scene, window.folder / "x.exr", Wishes(interval=60.0), print)
    found = []
    for scene in (window.scene, blender.data.scenes["Two"]):
        scene.view_layers[0].update()
        begun = frame.begin(scene.view_layers[0].depsgraph, "", pit_scene(), 0, print, keeps_meshes=True)
        found.append(begun.plan.path.name)
    assert found == ["x.exr.ngcheckpoint", "x.exr.Two.ngcheckpoint"]


def make_movie(scene: Any) -> None:
    if hasattr(scene.render.image_settings, "media_type"):
        scene.render.image_settings.media_type = "VIDEO"
    scene.render.image_settings.file_format = "FFMPEG"
    scene.render.ffmpeg.format = "MPEG4"


def test_frames_of_movies_are_called_as_the_movie_whatever_frames_it_has(window: Window) -> None:
    from addon.kept_frames import kept_path

    make_movie(window.scene)
    for first in (1, 12):
        window.scene.frame_start, window.scene.frame_end = first, 20
        for is_animation in (False, True):
            assert kept_path(window.scene, is_animation=is_animation).name == "x_.mp4.0001"
    window.scene.use_preview_range = True
    window.scene.frame_preview_start = 7
    assert kept_path(window.scene, is_animation=True).name == "x_.mp4.0001"


def test_of_long_frames_of_movies_it_is_said_how_they_go_on(window: Window) -> None:
    from addon import kept_frames

    shown = list[Notice]()
    make_movie(window.scene)
    for seconds in (1.0, 61.0):
        engine, report = SimpleNamespace(is_animation=True), SimpleNamespace(render_seconds=seconds)
        kept_frames.note_view(engine, SimpleNamespace(checkpointing=None), window.scene, report, shown.extend)
    assert [notice.subject for notice in shown] == ["Movie"]


def test_a_movie_that_is_cancelled_goes_on_with_its_frame_in_a_second_one(window: Window, capfd: Any) -> None:
    """What Blender has written of the first is whole."""
    import bpy

    make_movie(window.scene)
    kept = window.folder / "x_.mp4.0002.ngcheckpoint"
    assert window.cancel(kept.name, animation=True).status == "CANCELLED" and kept.exists()
    said = capfd.readouterr().err
    assert f"frame 2 is kept as far as it came, in {kept}" in said and "set Start to 2" in said
    first = window.folder / "x_0001-0002.mp4"
    # Hooks of ours cancel a frame, and Blender saves what there is of it, too.
    assert bpy.data.movieclips.load(str(first)).frame_duration in (1, 2)
    window.scene.frame_start = 2
    went_on = window.render(animation=True)
    assert went_on.status == "FINISHED" and 0 < went_on.resumed < SAMPLES
    assert names(window.folder) == ["x_0001-0002.mp4", "x_0002-0002.mp4"]
    assert bpy.data.movieclips.load(str(window.folder / "x_0002-0002.mp4")).frame_duration == 1


@posix
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGKILL])
def test_a_blender_that_is_ended_goes_on(window: Window, blender: Any, number: int) -> None:
    """It ends by the signal, as ever; before that it keeps what it has."""
    blender.ops.wm.save_mainfile()
    file, kept = str(window.folder / "scene.blend"), window.folder / "x_0001.exr.ngcheckpoint"
    line = [sys.executable, "-c", BLENDER.format(root=str(ROOT), file=file)]
    process = subprocess.Popen(line, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    wait_until(lambda: kept.exists() or process.poll() is not None)
    process.send_signal(number)
    said, _ = process.communicate(timeout=300)
    assert process.returncode == -number and kept.exists(), said
    if number == signal.SIGTERM:
        assert f"frame 1 is kept as far as it came, in {kept}" in said
    window.scene.frame_end = 1
    assert window.render(animation=True).resumed > 0
    assert names(window.folder) == ["x_0001.exr"]
