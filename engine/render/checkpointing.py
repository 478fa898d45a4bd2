# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps a render in a file while it goes on, so that another process can take it up where this one ends."""

from __future__ import annotations

import contextlib
import errno
import math
import shutil
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

from engine.guiding.fields.state import StateError
from engine.guiding.policy.learner import Learner
from engine.guiding.saved.learned import LOST, LearnedField
from engine.processes.file_locks import FileHold
from engine.render.checkpoint import Checkpoint, Identity
from engine.render.checkpoint_file import CheckpointError, load_checkpoint, load_film, save_checkpoint, sums_of
from engine.render.film import Film
from engine.render.film_addition import add_film
from engine.render.loop_state import LooksState, LoopState
from engine.render.request import RenderRequest
from engine.runtime.whole_files import remove_parts
from engine.scene.description import Notice
from engine.scene.digest import SceneDigest
from engine.scene.limits import check_copy
from engine.state.columns import copy_of
from engine.state.film import FilmTile

#: Between two checkpoints [s].
INTERVAL = 60.0
_SUBJECT = "Checkpoint"
_GOES_ON = "the render goes on without"
_TAKEN = "is of another process, which renders the same"


class CheckpointRefused(ValueError):
    """A render was to go on from a checkpoint, and cannot; the message says why."""


class _TakenElsewhere(OSError):
    """Another process renders the same into the same file."""


class KeptJob(Protocol):
    """What is kept of a job (`engine.render.job.AnyJob`)."""

    film: Film

    @property
    def film_lock(self) -> threading.Lock:
        """Held while the film is read."""

    @property
    def learner(self) -> Learner | None:
        """What learns."""

    def state(self, *, is_over: bool) -> LoopState | None:
        """How far it has come; None: there is no saying now."""

    def holding_tasks(self) -> contextlib.AbstractContextManager[object]:
        """Within it no task is handed out or finished."""


@dataclass(frozen=True)
class CheckpointPlan:
    """What is asked of a render's checkpoints.

    path : Path, of the file
    scene : SceneDigest
    seed : int, of the settings as the user has them
    interval : float, between two of them [s]
    most_rate : float, what may be written [bytes / s]: larger films are kept less often
    patience : float, how long a render takes that leaves a file where it is interrupted, or has kept its film, before
        its first checkpoint was due [s]
    resumes : bool, whether to go on from the file, if there is one
    insists : bool, whether to refuse a file that does not fit, instead of beginning anew
    film : Path or None, file of a finished film that is to have more samples
    merged : tuple of Path, films of other seeds that are to make the picture together, without any more samples
    keeps : bool, whether the file is to hold the finished film as well
    """

    path: Path
    scene: SceneDigest
    seed: int = 0
    interval: float = INTERVAL
    most_rate: float = math.inf
    patience: float = 0.0
    resumes: bool = False
    insists: bool = False
    film: Path | None = None
    merged: tuple[Path, ...] = ()
    keeps: bool = False


class Checkpointing:
    """The checkpoints of one render.

    Parameters
    ----------
    plan : CheckpointPlan
    tell : callable (Notice) -> None
        Is told what users should know, at once, in the thread that calls the methods.
    on_resumed : callable (int) -> None, optional
        Is told how many samples a pixel the film has that is taken up.

    Attributes
    ----------
    resumed : int
        That number; 0: the render began anew.
    """

    def __init__(
        self, plan: CheckpointPlan, tell: Callable[[Notice], None], on_resumed: Callable[[int], None] | None = None
    ) -> None:
        self.plan = plan
        self.resumed = 0
        self._tell, self._on_resumed = tell, on_resumed
        self._request: RenderRequest | None = None
        self._seed = 0
        self._executor = ThreadPoolExecutor(1, thread_name_prefix="checkpoint")
        self._writing: Future[None] | None = None
        self._began = self._due = 0.0
        self._interval = plan.interval
        self._hold = FileHold()
        #: Whether another process renders the same, so that this one leaves the file alone.
        self._is_off = False
        #: Whether what killed processes have left is removed: whoever writes looks for it.
        self._is_clean = False
        #: Whether the file holds a part of this render, and whether all of it.
        self.is_written = self.is_whole = False
        #: Whether this render has written the file, or taken it up, and whether it has come to its end.
        self.is_own = self.is_finished = False
        #: What was rendered before it ended [s].
        self.seconds = 0.0

    def begin(self, request: RenderRequest) -> tuple[RenderRequest, Film]:
        """The film, and what to go by: with what the file holds, if that is asked for and fits.

        Raises
        ------
        CheckpointRefused
            If it does not fit, and the plan insists, or asks for films that are there.
        """
        try:
            return self._begun(request)
        except BaseException:
            self.close()
            raise

    def _begun(self, request: RenderRequest) -> tuple[RenderRequest, Film]:
        """As `begin`."""
        self._request, self._seed = request, request.settings.seed
        film = request.make_film()
        self._interval = max(self.plan.interval, film.nbytes / self.plan.most_rate)
        self._began = time.monotonic()
        self._due = self._began + self._interval
        if self.plan.merged:
            return self._merging(request, film), film
        source, insists = self.plan.film or self.plan.path, self.plan.insists or self.plan.film is not None
        if not self.plan.resumes and self.plan.film is None:
            return request, film
        if not self._hold.take(self.plan.path):
            if insists:
                raise CheckpointRefused(f"{self.plan.path} {_TAKEN}")
            self._leave_alone()
            return request, film
        try:
            found = self._taken_up(request, film)
        except FileNotFoundError:
            if self.plan.film is not None:
                raise CheckpointRefused(
                    f"there is no film {self.plan.film}: render the frame with --keep-film first"
                ) from None
            return request, film
        except CheckpointError as error:
            if insists:
                raise CheckpointRefused(f"{source} {error}") from None
            self._tell(Notice(_SUBJECT, f"{source} {error}", "the frame begins anew"))
            return request, request.make_film()
        self.resumed, self.is_own = found.state.samples, True
        if self._on_resumed is not None:
            self._on_resumed(self.resumed)
        self._seed = found.seed
        return _going_on(request, found), film

    def _merging(self, request: RenderRequest, film: Film) -> RenderRequest:
        """Fill the film with all that are to be merged; what to go by, so that nothing is added."""
        identity = self._identity
        seeds: dict[int, Path] = {}
        path_count = 0
        for path in self.plan.merged:
            part = request.make_film()
            try:
                found = load_checkpoint(path)
                if problem := found.identity.difference(identity, free=("seed",)):
                    raise CheckpointError(problem)
                if found.seed in seeds:
                    problem = f"has the same samples as {seeds[found.seed]}: render each part by a seed of its own"
                    raise CheckpointError(problem)
                load_film(path, part)
            except FileNotFoundError:
                raise CheckpointRefused(f"there is no film {path}: render that part with --keep-film") from None
            except CheckpointError as error:
                raise CheckpointRefused(f"{path} {error}") from None
            seeds[found.seed] = path
            path_count += found.state.path_count
            add_film(film, part)
        return replace(request, resumed=LoopState(request.samples, path_count=path_count, ended_by="SAMPLES"))

    def _taken_up(self, request: RenderRequest, film: Film) -> Checkpoint:
        """Fill the film; returns how far it has come."""
        plan = self.plan
        if plan.film is None:
            found = self._fitting(plan.path)
            load_film(plan.path, film)
            return found
        finished = self._fitting(plan.film)
        # Adding may have been interrupted.
        with contextlib.suppress(FileNotFoundError, CheckpointError):
            begun = self._fitting(plan.path)
            if begun.state.path_count > finished.state.path_count:
                load_film(plan.path, film)
                return begun
        load_film(plan.film, film)
        # Pixels that were good enough are looked at anew, and the time that the others took does not count.
        state = replace(finished.state, ended_by="", seconds=0.0, looks=LooksState())
        if len(finished.state.looks.is_active):
            state = replace(state, first=state.samples + state.skipped, ends=state.ends[:0])
        return replace(finished, state=state)

    def _fitting(self, path: Path) -> Checkpoint:
        """The checkpoint of a file, if it is of what is to be rendered."""
        found = load_checkpoint(path)
        if problem := found.identity.difference(self._identity):
            raise CheckpointError(problem)
        return found

    @cached_property
    def _identity(self) -> Identity:
        """Of the film; asked for in one thread at a time."""
        assert self._request is not None
        return Identity.of_request(self._request, self.plan.scene.value, self.plan.seed)

    def poll(self, job: KeptJob) -> None:
        """Write one if it is time to; call it often, from one thread."""
        self._take_note()
        if time.monotonic() >= self._due and self._writing is None:
            self._write(job, is_over=False)

    def end(self, job: KeptJob, *, is_whole: bool) -> None:
        """The render is over: keep what there is.

        Parameters
        ----------
        is_whole : bool
            Whether it has come to its end, and was not interrupted.
        """
        self._take_note(waits=True)
        self.is_finished, self.seconds = is_whole, time.monotonic() - self._began
        is_worth_it = self.is_written or self.seconds >= self.plan.patience
        # Denoising and writing the picture take their time too.
        if self.is_written or (is_worth_it and self.plan.keeps) or (not is_whole and (is_worth_it or self.resumed)):
            self.is_written = False
            self._write(job, is_over=True)
            self._take_note(waits=True)
            self.is_whole = is_whole and self.is_written
        self._executor.shutdown(wait=True)

    def discard(self) -> None:
        """Remove the file, unless another process renders the same."""
        if not self._is_off and self._hold.take(self.plan.path):
            remove_parts(self.plan.path)
            with contextlib.suppress(OSError):
                self.plan.path.unlink(missing_ok=True)
        self.close()

    def close(self) -> None:
        """Leave the file to whoever wants to go on from it."""
        self._executor.shutdown(wait=True)
        self._hold.release()

    def _write(self, job: KeptJob, *, is_over: bool) -> None:
        """Begin to write how far a job is, unless it is where nobody can take it up."""
        if self._is_off:
            return
        try:
            check_copy(job.film.nbytes)
            copied = _copied(job, is_over=is_over)
        except MemoryError:
            self._due = time.monotonic() + self._interval
            self._tell(Notice(_SUBJECT, "there is no memory for a copy of the film", _GOES_ON))
            return
        if copied is None:
            return
        self._due = time.monotonic() + self._interval
        if copied[0].path_count:
            self._writing = self._executor.submit(self._save, *copied)

    def _save(self, state: LoopState, sums: dict[str, FilmTile], learned: LearnedField | None) -> None:
        """Write what was copied."""
        path = self.plan.path
        if not self._hold.take(path):
            raise _TakenElsewhere
        if not self._is_clean:
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_parts(path)
            self._is_clean = True
        _check_room(path.parent, sum(values.nbytes for tile in sums.values() for values in tile))
        if learned is not None:
            learned = replace(learned, light_digest=self._identity.scene)
        checkpoint = Checkpoint(self._identity, state, self._seed, learned)
        holds: list[FileHold] = []
        try:
            save_checkpoint(path, checkpoint, sums, lambda file: holds.append(FileHold.of_open(file)))
        except BaseException:
            for hold in holds:
                hold.release()
            raise
        # Until now others could see that the one before is held.
        self._hold.release()
        self._hold = holds[0]
        self.is_own = True

    def _leave_alone(self) -> None:
        self._is_off = True
        self._tell(Notice(_SUBJECT, f"{self.plan.path} {_TAKEN}", "this render is not kept"))

    def _take_note(self, *, waits: bool = False) -> None:
        """Whether what was begun is written."""
        if self._writing is None or not (waits or self._writing.done()):
            return
        writing, self._writing = self._writing, None
        try:
            writing.result()
            self.is_written = True
        except _TakenElsewhere:
            self._leave_alone()
        except (OSError, MemoryError) as error:
            reason = getattr(error, "strerror", "") or str(error) or type(error).__name__
            self._tell(Notice(_SUBJECT, f"{self.plan.path} cannot be written ({reason})", _GOES_ON))


def _going_on(request: RenderRequest, found: Checkpoint) -> RenderRequest:
    """What a render goes by that goes on from a checkpoint.

    The seed stays: samples that it has learned from are not taken again.
    """
    settings, learned = replace(request.settings, seed=found.seed), found.learned
    request = replace(request, resumed=found.state, settings=settings)
    if learned is None or request.learning.source is not None:
        return request
    if learned.verdict == LOST and settings.guiding_trial:
        # It would be tried again, and lose again.
        return replace(request, settings=replace(settings, guiding_method="OFF"))
    return replace(request, learning=replace(request.learning, start=learned))


def _check_room(folder: Path, size: int) -> None:
    """Raise OSError where a disk has no room for a file, and as much again for the picture.

    Parameters
    ----------
    size : int
        Of the file [bytes].
    """
    free = shutil.disk_usage(folder).free
    if free < 2 * size:
        raise OSError(errno.ENOSPC, f"it needs {size / 2**20:.0f} MiB, and as much again is left for the picture")


def _copied(job: KeptJob, *, is_over: bool) -> tuple[LoopState, dict[str, FilmTile], LearnedField | None] | None:
    """How far a job is, with its sums and what it has learned at the same moment."""
    with job.holding_tasks(), job.film_lock:
        state = job.state(is_over=is_over)
        if state is None:
            return None
        sums = {name: copy_of(tile) for name, tile in sums_of(job.film).items()}
        learner = job.learner
        learned = None
        # Where light is too bright for what is learned, it is learned anew.
        with contextlib.suppress(StateError):
            learned = None if learner is None else learner.learned("")
        if learned is not None:
            learned = replace(learned, state={name: values.copy() for name, values in learned.state.items()})
        return state, sums, learned
