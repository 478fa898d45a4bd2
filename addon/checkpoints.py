# SPDX-License-Identifier: GPL-3.0-or-later
"""Checkpoints of the frame that the command line renders: where they lie, and what becomes of them.

Each view layer, and each view of it, has a film of its own and so a file of its own, next to the frame's. It ends in
`.ngcheckpoint` while the frame is rendered, and in `.ngfilm` where the film of a finished frame is kept.
"""

from __future__ import annotations

import contextlib
import dataclasses
import math
import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any

import bpy

from . import console

if TYPE_CHECKING:
    from engine.render.checkpointing import Checkpointing
    from engine.scene.description import Notice, SceneDescription
    from engine.settings import RenderSettings

#: End names of files.
CHECKPOINT, FILM = ".ngcheckpoint", ".ngfilm"


@dataclasses.dataclass
class Wishes:
    """What the command line asks of frames' checkpoints.

    interval : float, between two of them [s]; 0: there are none
    resumes : bool, whether frames go on from theirs
    insists : bool, whether a frame fails whose checkpoint does not fit, instead of beginning anew
    keeps : bool, whether the films of finished frames are kept
    added : int, samples a pixel that finished frames are to get; 0: frames are rendered as ever
    merged : list of str, paths of pictures, with #### for the frame's number, whose films make the frame together
    """

    interval: float = 60.0
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


class FrameCheckpoints:
    """The checkpoints of one frame.

    Parameters
    ----------
    path : Path
        The frame's first file.
    wishes : Wishes
    """

    def __init__(self, path: Path, wishes: Wishes) -> None:
        self._path, self._wishes = path, wishes
        self._begun: list[Checkpointing] = []

    def begin(
        self, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription, part_count: int,
        seed: int, tell: Callable[[Notice], None],
    ) -> Checkpointing:
        """Those of a view layer, or of a view of it.

        Parameters
        ----------
        part_count : int
            Films that the frame has.
        seed : int
            Of the settings.
        tell : callable (Notice) -> None
        """
        from engine.render.checkpointing import Checkpointing, CheckpointPlan
        from engine.scene.digest import content_digest, scene_digest

        scene, layer = depsgraph.scene, depsgraph.view_layer_eval.name
        part = f".{scene.view_layers.find(layer)}" if part_count > 1 else ""
        part += f"-{bpy.path.clean_name(view)}" if part and view else ""
        name, wishes = self._path.name + part, self._wishes
        film = self._path.with_name(name + FILM)
        plan = CheckpointPlan(
            self._path.with_name(name + CHECKPOINT),
            content_digest((scene.name, layer, view, scene_digest(description))), seed,
            interval=wishes.interval or math.inf, resumes=wishes.resumes, insists=wishes.insists,
            film=film if wishes.added else None,
            merged=tuple(_film_of(picture, scene.frame_current, part) for picture in wishes.merged),
            keeps=not wishes.merged and bool(wishes.keeps or wishes.added or part_count > 1),
        )
        frame = scene.frame_current

        def on_resumed(samples: int) -> None:
            console.say(f"NeuralGuide: frame {frame} goes on from {samples} samples a pixel, which were kept")

        checkpointing = Checkpointing(plan, tell, on_resumed)
        self._begun.append(checkpointing)
        return checkpointing

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

    def finish(self) -> None:
        """The frame's picture is written: keep the films, if that is asked for, and nothing else."""
        for checkpointing in self._begun:
            path = checkpointing.plan.path
            if (self._wishes.keeps or self._wishes.added) and checkpointing.is_whole:
                try:
                    os.replace(path, path.with_suffix(FILM))
                except OSError as error:
                    console.complain(f"{path} cannot be kept as a film ({error.strerror or error})")
            checkpointing.discard()

    def tell_kept(self, frame: int) -> None:
        """Say how a frame that was interrupted can be taken up, if it can."""
        kept = [item.plan.path for item in self._begun if item.is_written]
        if kept:
            option = "--add-samples" if self._wishes.added else "--resume"
            console.say(f"NeuralGuide: frame {frame} is kept as far as it came, in {kept[0]}: {option} goes on from it")


def _film_of(picture: str, frame: int, part: str) -> Path:
    """The film that was kept next to a picture, or what was kept of it before it was finished."""
    numbered = re.sub("#+", lambda match: f"{frame:0{len(match[0])}d}", bpy.path.abspath(picture))
    path = Path(numbered).absolute()
    film, checkpoint = (path.with_name(path.name + part + suffix) for suffix in (FILM, CHECKPOINT))
    return checkpoint if checkpoint.exists() and not film.exists() else film


#: Of the frame in work; None: nothing of it is kept.
current: FrameCheckpoints | None = None


def begin_frame(paths: Any, wishes: Wishes) -> FrameCheckpoints | None:
    """The checkpoints of a frame of these files; None: there are to be none."""
    is_wanted = wishes.interval > 0.0 or wishes.resumes or wishes.keeps or wishes.added or wishes.merged
    return FrameCheckpoints(paths[0], wishes) if paths and is_wanted else None


def forget(path: Path) -> None:
    """Remove checkpoints that a killed process has left of a frame that is finished: nobody goes on from them, unless
    samples were being added to a film.
    """
    with contextlib.suppress(OSError):
        for item in path.parent.iterdir():
            is_left = item.name.startswith(path.name + ".") and item.name.endswith(CHECKPOINT)
            if is_left and not item.with_suffix(FILM).exists():
                item.unlink(missing_ok=True)


def begin_view(
    session: Any, settings: Any, depsgraph: bpy.types.Depsgraph, view: str, description: SceneDescription,
    part_count: int, show: Callable[[list[Notice]], None],
) -> None:
    """Have a session keep what it renders next, if the frame in work is to be kept."""
    session.settings, session.checkpointing = settings, None
    if current is not None:
        checkpointing = current.begin(
            depsgraph, view, description, part_count, settings.seed, lambda notice: show([notice])
        )
        session.settings = current.settings(checkpointing, settings)
        session.checkpointing = checkpointing
