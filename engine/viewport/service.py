# SPDX-License-Identifier: GPL-3.0-or-later
"""The process's loop: takes updates, renders the newest state coarsely and then ever better, shows pictures.

A message comes as one JSON object a line: `update` (number, size), whose content lies in shared memory
(`transfer.py`). Everything else goes through a block of shared memory (`protocol.py`). When the input ends, the process
does.
"""

from __future__ import annotations

import errno
import json
import os
import sys
import threading
import time
import traceback
from dataclasses import replace
from functools import partial
from typing import Any, BinaryIO, TextIO

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.saved.judge import FieldJudge
from engine.guiding.saved.learned import LearnedField
from engine.processes.memory import SharedMemory
from engine.processes.parent import leave_with_parent, step_back
from engine.render.denoising import Denoising
from engine.render.film import Images
from engine.render.report import Progress
from engine.render.session import Session
from engine.scene.description import Notice
from engine.settings import RenderSettings
from engine.viewport.mixing import group_passes, mixed_picture
from engine.viewport.pacing import PACE, Pacing
from engine.viewport.protocol import BUILDING, COMPILING, DONE, FAILED, PAUSED, RENDERING, WAITING, Block, Status
from engine.viewport.transfer import Receiver
from engine.viewport.view import Update, View

#: Pace of a coarse picture: it is shown once, when it is finished.
_COARSE_PACE = replace(PACE, times=(), interval=1e9, longest=1e9)
#: Least time from one denoising to the next [s], and that time over the time that the last one took.
_DENOISE_SECONDS = 1.0
_DENOISE_PATIENCE = 3.0
_OUT_OF_MEMORY = "Out of memory: make the view smaller, or simplify meshes and textures"
#: Time between two looks at how far a render is [s].
_STATUS_SECONDS = 0.1


class Inbox:
    """Updates that have come and were not taken; those that wait are one."""

    def __init__(self) -> None:
        #: Whether light groups are rendered, so that other factors of theirs need no other render.
        self.mixes = False
        self._changed = threading.Condition()
        self._waiting: Update | None = None
        self._number = 0

    def put(self, update: Update, number: int) -> None:
        """Add an update (any thread)."""
        with self._changed:
            self._waiting = update if self._waiting is None else self._waiting.then(update)
            self._number = number
            self._changed.notify_all()

    @property
    def has_news(self) -> bool:
        """Whether something waits that needs another render."""
        waiting = self._waiting
        return waiting is not None and not (self.mixes and waiting.is_mix_alone)

    def take(self) -> tuple[Update, int]:
        """All that waits, and the number of its newest; waits for something to come."""
        self.wait()
        with self._changed:
            assert self._waiting is not None  # nobody else takes
            update, self._waiting = self._waiting, None
            return update, self._number

    def wait(self) -> None:
        """Wait for something to come."""
        with self._changed:
            while self._waiting is None:
                self._changed.wait()

    def take_mix(self) -> tuple[Update, int] | None:
        """All that waits, if that is factors of light groups alone."""
        with self._changed:
            if self._waiting is None or not self._waiting.is_mix_alone:
                return None
            update, self._waiting = self._waiting, None
            return update, self._number


class Service:
    """One view, served.

    Parameters
    ----------
    config : dict
        As `ViewProcess` writes it.
    """

    def __init__(self, config: dict[str, Any]) -> None:
        self.block = Block.attach(config["block"])
        self._receiver = Receiver(SharedMemory.attach(config["transfer"]))
        self._inbox = Inbox()
        self._pacing = Pacing()
        self._session: Session | None = None
        self._status = Status()
        self._told = 0.0
        self._number = 0
        #: What is to be rendered: all updates so far as one.
        self._state = Update()
        #: What was learned last, maybe of the scene before an edit.
        self._field: LearnedField | None = None
        #: The last whole picture of this update, for pixels of a finer one that have no sample yet.
        self._coarse: tuple[Images, int] | None = None
        #: What is shown, before it was mixed: passes, view and divider.
        self._shown: tuple[Images, View, int] | None = None
        self._denoising = Denoising(RenderSettings(use_denoising=False), 1)
        #: When the picture of this update may be denoised next, and whether it was.
        self._next_denoising = 0.0
        self._is_denoised = False

    def listen(self, stream: BinaryIO) -> None:
        """Read messages until there are no more (thread)."""
        try:
            for line in stream:
                message = json.loads(line)
                update = self._receiver.read(message["size"])
                self._inbox.put(update, message["number"])
                self.block.acknowledge(message["number"])
        except BaseException as error:
            # The host takes the update for read: only another process can make up for it.
            lacks_memory = isinstance(error, MemoryError) or getattr(error, "errno", None) == errno.ENOMEM
            print(_OUT_OF_MEMORY if lacks_memory else repr(error), file=sys.stderr, flush=True)
            os._exit(1)
        os._exit(0)

    def run(self) -> None:
        """Render until the input ends."""
        while True:
            self.block.beat()
            self._inbox.wait()
            try:
                if not self._mix_anew():
                    self._begin()
            except ValueError as error:
                self._tell(FAILED, str(error))
            except MemoryError:
                self._tell(FAILED, _OUT_OF_MEMORY)
            except OSError as error:
                self._tell(FAILED, f"No shared memory for pictures: {error.strerror or error}")

    # One state, rendered

    def _begin(self) -> None:
        """Render by all that waits."""
        update, self._number = self._inbox.take()
        started = time.perf_counter()
        self._state = self._state.then(update)
        self._inbox.mixes = bool(self._state.mix)
        # Held by the state alone: a scene that is replaced is freed before the next is built.
        scene_changed, update = update.scene is not None, Update()
        if self._state.is_paused:
            self._tell(PAUSED, "Paused")
        elif self._state.view is None or self._state.settings is None or self._state.scene is None:
            self._tell(WAITING, "")
        else:
            self._render(self._state.view, scene_changed, started)

    def _render(self, view: View, scene_changed: bool, started: float) -> None:
        session = self._load(view, scene_changed)
        x0, y0, x1, y1 = view.region
        self._coarse = self._shown = None
        self._is_denoised = False
        judge = self._judge(session)
        field = self._field if judge is None else judge.field
        dividers = self._pacing.dividers(x1 - x0, y1 - y0)
        for divider in dividers:
            # The first picture comes whatever follows: who moves on and on would never see one.
            is_first = divider == dividers[0]
            if not is_first and self._inbox.has_news:
                return
            session.look(*view.at(divider))
            if divider == 1:
                self._render_finely(session, view, judge, is_first)
                return
            before = time.perf_counter()
            result = session.render(
                samples=1, start=field, sink=judge, pace=_COARSE_PACE, on_progress=self._on_progress,
                should_cancel=lambda is_first=is_first: not is_first and self._inbox.has_news,  # type: ignore[misc]
                passes=self._passes, shows_cancelled=False,
            )
            if result.report.ended_by == "CANCEL":
                return
            tracing = result.report.render_seconds
            self._show(result.passes, view, divider)
            self._coarse = result.passes, divider
            if not (scene_changed and is_first):
                # What a new scene takes to be built is no measure of the next view of it.
                begun = started if is_first else before
                self._pacing.note(result.report.path_count, tracing, time.perf_counter() - begun)

    def _load(self, view: View, scene_changed: bool) -> Session:
        """The session, with the newest scene and settings."""
        settings, scene = self._state.settings, self._state.scene
        assert settings is not None and scene is not None
        session = self._session
        # The session would denoise coarse pictures and last ones only.
        own = replace(settings, use_denoising=False, denoised_threshold=0.0)
        if session is None:
            session = self._session = Session(own, expects_moves=True)
        if session.settings != own:
            session.settings = own
            scene_changed = True
        self._denoising = Denoising(settings, session.thread_count)
        if scene_changed or session.scene is None:
            camera, frame = view.at(1)
            self._status.notices = []
            self._tell(BUILDING, "Building the scene")
            notices = session.load(replace(scene, camera=camera, frame=frame), on_progress=self._on_loading)
            self._note(notices)
        return session

    def _judge(self, session: Session) -> FieldJudge | None:
        """What finds out by the coarse pictures whether the field fits an edited scene; None: it is of this one."""
        field = self._field
        if field is None or not session.settings.is_guided or field.light_digest == session.light_digest:
            return None
        return FieldJudge(field, session.light_digest)

    def _conclude(self, session: Session, judge: FieldJudge) -> bool:
        """Keep the field, or learn anew; False if something else is to be rendered by now."""
        if not judge.is_sure:
            # No picture was fine enough.
            session.render(
                samples=1, start=judge.field, sink=judge, pace=_COARSE_PACE, on_progress=self._on_progress,
                should_cancel=lambda: self._inbox.has_news, passes=self._passes, shows_cancelled=False,
            )
        if self._inbox.has_news:
            return False
        self._field = judge.kept
        return True

    def _render_finely(self, session: Session, view: View, judge: FieldJudge | None, is_first: bool) -> None:
        if judge is not None and not self._conclude(session, judge):
            return
        has_image = False

        def on_image(images: Images) -> None:
            nonlocal has_image
            self._show(images, view, 1)
            has_image = True

        def should_cancel() -> bool:
            self.block.beat()
            self._mix_anew()
            return self._inbox.has_news and (has_image or not is_first)

        result = session.render(
            start=self._field, keep=True, pace=PACE, on_progress=partial(self._on_progress, is_fine=True),
            on_image=on_image,
            should_cancel=should_cancel, passes=self._passes, shows_cancelled=False,
        )
        if result.learned is not None:
            self._field = result.learned
        self._note([*result.report.notices, *self._denoising.notices])
        self._status.guiding = "; ".join(result.report.guiding.lines)
        if result.report.ended_by != "CANCEL":
            self._next_denoising = 0.0
            self._show(result.passes, view, 1)
            self._tell(DONE, "Done", sample=round(result.report.sample_count), samples=self._status.samples)

    def _mix_anew(self) -> bool:
        """Show the picture by other factors of light groups, if such have come; whether that is so."""
        taken = self._inbox.take_mix() if self._inbox.mixes else None
        if taken is None:
            return False
        update, self._number = taken
        self._state = self._state.then(update)
        if self._shown is not None:
            self._next_denoising = 0.0
            self._show(*self._shown)
        self._status = replace(self._status, update=self._number)
        self.block.write_status(self._status)
        return True

    def _mixed(self, images: Images) -> Float32Array:
        """Combined by the factors of light groups."""
        return mixed_picture(images, self._light_groups, self._state.mix)

    @property
    def _light_groups(self) -> tuple[str, ...]:
        return () if self._state.scene is None else self._state.scene.light_groups

    def _show(self, images: Images, view: View, divider: int) -> None:
        self._shown = images, view, divider
        pixels = self._mixed(images)
        images = {**images, "Combined": pixels}
        x0, y0, x1, y1 = view.region
        if divider > 1:
            x0, y0 = x0 // divider * divider, y0 // divider * divider
            x1, y1 = x0 + pixels.shape[1] * divider, y0 + pixels.shape[0] * divider
        else:
            count = images["Sample Count"]
            if self._denoising.is_on and count.min() > 0.0 and count.mean() >= (self._state.denoises_from or 1):
                if not self._denoise(images):
                    return
                pixels = images["Combined"]
            elif self._coarse is not None:
                coarse, size = self._coarse
                fill_unsampled(pixels, count, self._mixed(coarse), size, (x0, y0))
        self.block.write_image(pixels, (x0, y0, x1, y1), divider, self._number)

    def _denoise(self, images: Images) -> bool:
        """Denoise, but not all the time; whether there is something to show.

        A picture that was denoised is not followed by a noisy one.
        """
        now = time.monotonic()
        if now < self._next_denoising:
            return not self._is_denoised
        if not self._denoising.run(images, lambda: self._inbox.has_news):
            return False
        self._is_denoised = True
        self._next_denoising = now + max(_DENOISE_SECONDS, _DENOISE_PATIENCE * self._denoising.seconds)
        return True

    @property
    def _passes(self) -> frozenset[str]:
        """Passes of every picture, always the same: kernels are linked for what is asked of them."""
        groups = group_passes(self._light_groups, self._state.mix)
        return frozenset({"Combined", "Sample Count"}) | self._denoising.passes | groups

    # Telling the host

    def _tell(
        self, state: str, message: str, *, sample: int = 0, samples: int = 0, remaining: float | None = None
    ) -> None:
        self._status = replace(
            self._status, state=state, message=message, sample=sample, samples=samples, remaining=remaining,
            update=self._number,
        )  # fmt: skip
        self.block.write_status(self._status)
        self._told = time.monotonic()

    def _note(self, notices: list[Notice]) -> None:
        known = dict.fromkeys(self._status.notices)
        known |= dict.fromkeys((item.subject, item.problem, item.fallback) for item in notices)
        self._status.notices = list(known)

    def _on_loading(self, progress: Progress) -> None:
        self.block.beat()
        if time.monotonic() - self._told > _STATUS_SECONDS:
            self._tell(COMPILING if "ompiling" in progress.message else BUILDING, progress.message)

    def _on_progress(self, progress: Progress, *, is_fine: bool = False) -> None:
        self.block.beat()
        if time.monotonic() - self._told > _STATUS_SECONDS or self._status.state != RENDERING:
            self._tell(
                RENDERING, progress.message, sample=progress.sample if is_fine else 0, samples=progress.samples,
                remaining=progress.remaining,
            )  # fmt: skip


def fill_unsampled(
    pixels: Float32Array, sample_count: Float32Array, coarse: Float32Array, divider: int, origin: tuple[int, int]
) -> None:
    """Give pixels without a sample those of a coarser picture.

    Parameters
    ----------
    pixels : float32 (H, W, 4), written
    sample_count : float32 (H, W, 1)
    coarse : float32 (h, w, 4), whose pixels are squares of `divider` pixels, counted from the window's corner
    origin : (x, y), of `pixels` in the window
    """
    rows, columns = np.nonzero(sample_count[..., 0] == 0.0)
    if not len(rows):
        return
    x, y = origin
    at_row = (rows + y) // divider - y // divider
    at_column = (columns + x) // divider - x // divider
    pixels[rows, columns] = coarse[at_row, at_column]


def serve(config: dict[str, Any], stream: BinaryIO, _answers: TextIO) -> None:
    """Run the service in this process. What it raises ends the process: the last line of its errors says why."""
    step_back(config)
    leave_with_parent(config)
    service = Service(config)
    threading.Thread(target=service.listen, args=(stream,), name="messages", daemon=True).start()
    try:
        service.run()
    except BaseException:
        traceback.print_exc()
        sys.stderr.flush()
    # Other threads may be anywhere.
    os._exit(1)
