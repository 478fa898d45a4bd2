# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of a frame: where they lie, and what becomes of them.

Each view layer, and each view of it, has a film of its own and so a file of its own, next to the frame's. It ends in
`.ngcheckpoint` while the frame is rendered, and in `.ngfilm` where the film of a finished frame is kept.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import bpy

from . import console
from .frame_parts import part_count

if TYPE_CHECKING:
    from engine.render.checkpointing import Checkpointing
    from engine.scene.description import Notice, SceneDescription
    from engine.settings import RenderSettings

#: End names of files.
CHECKPOINT, FILM = ".ngcheckpoint", ".ngfilm"
#: Where nobody says how often: between two checkpoints [s], and what they may write on average [bytes / s].
INTERVAL, MOST_RATE = 60.0, float(4 << 20)


@dataclasses.dataclass
class Wishes:
    """What is asked of frames' checkpoints.

    interval : float or None, between two of them [s]; 0: there are none, None: as the scene says
    most_rate : float, what they may write [bytes / s]
    is_patient : bool, whether renders that are shorter than that leave no file
    resumes : bool, whether frames go on from theirs
    insists : bool, whether a frame fails whose checkpoint does not fit, instead of beginning anew
    keeps : bool, whether the films of finished frames are kept
    added : int, samples a pixel that finished frames are to get; 0: frames are rendered as ever
    merged : list of str, paths of pictures, with #### for the frame's number, whose films make the frame together
    """

    interval: float | None = None
    most_rate: float = math.inf
    is_patient: bool = False
    resumes: bool = False
    insists: bool = False
    keeps: bool = False
    added: int = 0
    merged: list[str] = dataclasses.field(default_factory=list)

    def take(self, option: str, value: str) -> bool:
        """Take an option of the command line; False: it is about something else."""
        if option == "checkpoint":
            self.interval = float(value)
        elif option == "keep-film":
            self.keeps = True
        elif option == "add-samples":
            self.added = int(value)
        elif option == "merge":
            self.merged.append(value)
        else:
            # Those leave finished frames alone as well, which is not said here.
            self.resumes = self.resumes or option in ("resume", "resume-or-fail")
            self.insists = self.insists or option == "resume-or-fail"
            return False
        return True


    def of_scene(self, scene: bpy.types.Scene) -> Wishes:
        """The same where the scene has been asked what it leaves open."""
        ours = scene.neuralguide
        asked = dataclasses.replace(self, keeps=self.keeps or (ours.keep_unfinished and ours.keep_film))
        if self.interval is not None:
            return asked
        if ours.keep_unfinished:
            return dataclasses.replace(asked, interval=INTERVAL, most_rate=MOST_RATE)
        return dataclasses.replace(asked, interval=0.0)

    @property
    def is_any(self) -> bool:
        """Whether anything is asked."""
        return bool(self.interval or self.resumes or self.keeps or self.added or self.merged)


class FrameCheckpoints:
    """The checkpoints of one frame.

    Parameters
    ----------
    scene : Scene
        That is rendered; others may be parts of its picture.
    path : Path
        Of the frame: names of its checkpoints begin with it.
    wishes : Wishes
        Without what is left open.
    say : callable (str) -> None
        Is told what becomes of the frame.
    """

    def __init__(self, scene: bpy.types.Scene, path: Path, wishes: Wishes, say: Callable[[str], None]) -> None:
        self._scene_name, self._part_count = scene.name, part_count(scene)
        self._path, self._wishes, self._say = path, wishes, say
        self._begun: list[Checkpointing] = []

    def begin(
        self, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription, seed: int,
        tell: Callable[[Notice], None], *, keeps_meshes: bool,
    ) -> Checkpointing:
        """Those of a view layer, or of a view of it.

        Parameters
        ----------
        seed : int
            Of the settings.
        tell : callable (Notice) -> None
        keeps_meshes : bool
            As of `Session.load`.
        """
        from engine.render.checkpointing import Checkpointing, CheckpointPlan
        from engine.scene.digest import SceneDigest

        scene, layer = depsgraph.scene, depsgraph.view_layer_eval.name
        has_parts = part_count(scene) > 1
        part = self._part(scene, layer, view if has_parts else "", description, has_number=has_parts)
        name, wishes = self._path.name + part, self._wishes
        film = self._path.with_name(name + FILM)
        plan = CheckpointPlan(
            self._path.with_name(name + CHECKPOINT),
            SceneDigest(description, (scene.name, layer, view), keeps_meshes=keeps_meshes), seed,
            interval=wishes.interval or math.inf, most_rate=wishes.most_rate, patience=self._patience(),
            resumes=wishes.resumes, insists=wishes.insists, film=film if wishes.added else None,
            merged=tuple(_film_of(picture, scene.frame_current, part) for picture in wishes.merged),
            keeps=not wishes.merged and bool(wishes.keeps or wishes.added or has_parts),
        )
        frame = scene.frame_current

        def on_resumed(samples: int) -> None:
            self._say(f"frame {frame} goes on from {samples} samples a pixel, which were kept")

        checkpointing = Checkpointing(plan, tell, on_resumed)
        self._begun.append(checkpointing)
        return checkpointing

    def _part(
        self, scene: bpy.types.Scene, layer: str, view: str, description: SceneDescription, *, has_number: bool
    ) -> str:
        """What names of a part's files have behind the frame's own."""
        part = "" if scene.name == self._scene_name else f".{bpy.path.clean_name(scene.name)}"
        part += f".{scene.view_layers.find(layer)}" if has_number else ""
        part += f"-{bpy.path.clean_name(view)}" if view else ""
        frame = description.frame
        # Whoever tries a part of the picture wants to go on with the whole of it later.
        return part + ("" if frame.region == (0, 0, frame.width, frame.height) else ".border")

    def _patience(self) -> float:
        """How long the next part takes that is kept: what is lost of a frame is to be no more than that [s]."""
        if not self._wishes.is_patient or self._wishes.keeps:
            return 0.0
        lost = sum(item.seconds for item in self._begun if item.is_finished and not item.is_whole)
        return max((self._wishes.interval or math.inf) - lost, 0.0)

    def settings(self, checkpointing: Checkpointing, settings: RenderSettings) -> RenderSettings:
        """What a part is rendered by: if samples are added, more of them than the finished film has."""
        from engine.render.checkpoint_file import CheckpointError, load_checkpoint

        # Without a film that can be read the render is refused, and says why.
        with contextlib.suppress(OSError, CheckpointError):
            if checkpointing.plan.film is not None:
                found = load_checkpoint(checkpointing.plan.film)
                settings = dataclasses.replace(settings, samples=found.state.samples + self._wishes.added)
                if settings.radiance_cache == "AUTO" and found.identity.settings.get("radiance_cache") == "OFF":
                    # So few samples were no reason to try it. The film stays what it is.
                    settings = dataclasses.replace(settings, radiance_cache="OFF")
        return settings

    @property
    def is_finished(self) -> bool:
        """Whether all parts of the frame have come to their end."""
        return len(self._begun) >= self._part_count and all(item.is_finished for item in self._begun)

    def finish(self) -> None:
        """The frame's picture is written: keep the films, if that is asked for, and nothing else.

        Where renders have patience, a file that one of them had no use for stays: it may be of the scene as it will be
        again, such as at its full size.
        """
        for checkpointing in self._begun:
            path = checkpointing.plan.path
            if (self._wishes.keeps or self._wishes.added) and checkpointing.is_whole:
                try:
                    os.replace(path, path.with_suffix(FILM))
                except OSError as error:
                    console.complain(f"{path} cannot be kept as a film ({error.strerror or error})")
            if checkpointing.is_own or not self._wishes.is_patient:
                checkpointing.discard()
        self.close()

    def close(self) -> None:
        """Leave the files to whoever wants to go on from them."""
        for checkpointing in self._begun:
            checkpointing.close()

    def tell_kept(self, frame: int) -> None:
        """Say how a frame that was interrupted can be taken up, if it can."""
        kept = [item.plan.path for item in self._begun if item.is_written]
        if kept:
            option = "--add-samples" if self._wishes.added else "--resume"
            self._say(f"frame {frame} is kept as far as it came, in {kept[0]}: {option} goes on from it")


def _film_of(picture: str, frame: int, part: str) -> Path:
    """The film that was kept next to a picture, or what was kept of it before it was finished."""
    numbered = re.sub("#+", lambda match: f"{frame:0{len(match[0])}d}", bpy.path.abspath(picture))
    path = Path(numbered).absolute()
    film, checkpoint = (path.with_name(path.name + part + suffix) for suffix in (FILM, CHECKPOINT))
    return checkpoint if checkpoint.exists() and not film.exists() else film


#: Of the frame that the command line renders; None: nothing of it is kept.
commanded: FrameCheckpoints | None = None


def begin_frame(scene: bpy.types.Scene, paths: Sequence[Path], wishes: Wishes) -> FrameCheckpoints | None:
    """The checkpoints of a frame of these files that the command line renders; None: there are to be none."""
    asked = wishes.of_scene(scene)
    if not paths or not asked.is_any:
        return None
    return FrameCheckpoints(scene, paths[0], asked, lambda text: console.say(f"NeuralGuide: {text}"))


def end_frame() -> None:
    """That frame is rendered, or is not to be."""
    global commanded
    if commanded is not None:
        commanded.close()
    commanded = None


def files_of(path: Path) -> list[Path]:
    """Checkpoints of a frame that are there.

    Parameters
    ----------
    path : Path
        Of the frame.
    """
    with contextlib.suppress(OSError):
        found = [item for item in path.parent.iterdir() if item.name.endswith(CHECKPOINT)]
        return [item for item in found if item.name.startswith(path.name + ".")]
    return []


def remove(path: Path) -> bool:
    """Remove a checkpoint; False: another process renders what is in it, or the folder cannot be written."""
    from engine.processes.file_locks import FileHold

    hold = FileHold()
    if not hold.take(path):
        return False
    try:
        path.unlink(missing_ok=True)
    except OSError:
        return False
    finally:
        hold.release()
    return True


def forget(path: Path) -> None:
    """Remove checkpoints that a killed process has left of a frame that is finished: nobody goes on from them, unless
    samples were being added to a film.
    """
    for item in files_of(path):
        if not item.with_suffix(FILM).exists():
            remove(item)
