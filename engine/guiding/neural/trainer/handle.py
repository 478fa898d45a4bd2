# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer's handle on the worker that trains a network. Knows no torch, never blocks, never raises.

Whatever goes wrong with the worker ends in `TrainerStatus.state == DEAD` with a message, and rendering goes on with the
last snapshot or without one.
"""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
import threading
from collections.abc import Callable
from typing import Any

from engine.array_types import Float32Array
from engine.guiding.neural.networks.radiance import Snapshot, TrainableShape, TrainingSettings
from engine.guiding.neural.trainer import standby
from engine.guiding.neural.trainer.channel import FIRST_SLOT, Channel
from engine.guiding.neural.trainer.reader import Reader
from engine.guiding.neural.trainer.status import TrainerState, TrainerStatus, WorkerNews
from engine.guiding.records.light import Records
from engine.processes.child import ENTRY, Child


class NetworkTrainer:
    """Trains a network in another process.

    Parameters
    ----------
    shape : NetworkShape, MixtureShape
        The network's; its kind says how it is trained.
    bounds : float32 (2, 3) [m] or None
        What the network resolves; None: nearly all of the first records' positions (`radiance.robust_bounds`).
    seed : int
    training_share : float in (0, 1]
        Share of the machine's processor time that training may use.
    deterministic : bool
        Train in `train_until` only, on one thread: the same records give the same snapshot.
    settings : TrainingSettings, MixtureSettings
        As the kind of network has; None: the defaults of its shape.
    on_command : bool
        Train in `train_until` only, as with `deterministic`, but on all of `thread_count` threads.
    interpreter : str or None
        Python for the worker; None: the renderer's own.
    thread_count : int
        Threads of the worker, 0: as many as its share of the processors asks for.
    first : Snapshot or None
        What training goes on from, of a radiance network; None: it begins anew.
    start_timeout, answer_timeout : float [s]
        Silence after which the worker counts as hung, while it starts and later.

    Attributes
    ----------
    script : Path
        What the worker runs; before `start` it may be replaced by anything that speaks the same protocol.

    Notes
    -----
    A worker that stands by (`standby`) is taken, and given back by `close`.
    """

    def __init__(
        self,
        shape: TrainableShape,
        bounds: Float32Array | None = None,
        seed: int = 0,
        training_share: float = 0.25,
        deterministic: bool = False,
        settings: TrainingSettings | None = None,
        on_command: bool = False,
        interpreter: str | None = None,
        thread_count: int = 0,
        first: Snapshot | None = None,
        start_timeout: float = 120.0,
        answer_timeout: float = 30.0,
    ) -> None:
        if not 0.0 < training_share <= 1.0:
            raise ValueError(f"training_share is {training_share}: choose a fraction above 0 and at most 1")
        self.shape = shape
        self.settings = settings or shape.training_settings
        self._bounds = bounds
        self._seed = seed
        self._training_share = training_share
        self._deterministic = deterministic
        self._on_command = on_command or deterministic
        self._interpreter = interpreter or sys.executable
        self._thread_count = thread_count or max(1, round(training_share * (os.cpu_count() or 1)))
        self._first = first
        self.script = ENTRY
        self._news = WorkerNews(start_timeout, answer_timeout)
        # Guarded by the lock of the news.
        self._channel: Channel | None = None
        self._child: Child | None = None
        self._reader: Reader | None = None
        self._submission_count = 0
        self._told_step = 0

    # Life

    def start(self) -> None:
        """Start the worker, and return at once."""
        if not self._news.begin():
            return
        try:
            self._channel = Channel.create(self.shape, self.settings)
            if self._first is not None:
                self._channel.write_snapshot(FIRST_SLOT, self._first)
        except OSError as error:
            self._die(f"no shared memory for the training worker: {error.strerror or error}")
            return
        try:
            self._launch(self._channel)
        except OSError as error:
            self._die(f"the training worker could not be started: {error}")

    def _launch(self, channel: Channel) -> None:
        config = {
            "kind": self.shape.kind,
            "shape": dataclasses.asdict(self.shape),  # type: ignore[call-overload]
            "settings": dataclasses.asdict(self.settings),
            "bounds": None if self._bounds is None else self._bounds.tolist(),
            "seed": self._seed,
            "deterministic": self._deterministic,
            "on_command": self._on_command,
            "training_share": self._training_share,
            "thread_count": self._thread_count,
            "goes_on": self._first is not None,
        }
        taken = standby.take(self._interpreter) if self.script == ENTRY else None
        before = None
        if taken is None:
            child = standby.launch(
                self._interpreter, config | {"channel": channel.address}, thread_count=self._thread_count,
                memories=(channel.memory,), script=self.script,
            )
        else:
            child, before = taken.worker, taken.reader
            child.send(kind="job", config=config | {"channel": channel.address_for_others})
        self._child = child
        self._reader = Reader(child, before, self._news, self._die)
        self._reader.start()

    @property
    def process(self) -> subprocess.Popen[bytes] | None:
        """The worker while there is one; the trainer ends it and waits for it."""
        child = self._child
        return None if child is None else child.process

    def close(self) -> None:
        """Stop training and give the memory back; the trainer cannot be used again.

        The worker stays for the next one, if it is well.
        """
        self._give_back()
        self._die("closed")

    def _give_back(self) -> None:
        """Leave the worker to the next training, if it is well, or still starting."""
        with self._news.changed:
            state, child, reader = self._news.status.state, self._child, self._reader
            if state in (TrainerState.OFF, TrainerState.DEAD) or not self._may_stay or child is None or reader is None:
                return
            self._child = self._reader = None
            if state is TrainerState.STARTING and self._channel is not None:
                reader.close_at_end(self._channel)
                self._channel = None
        child.send(kind="leave")
        standby.keep(child, reader, is_starting=state is TrainerState.STARTING)

    @property
    def _may_stay(self) -> bool:
        """Whether the worker is one that anybody could take."""
        return standby.CAN_STAND_BY and self.script == ENTRY and self._interpreter == sys.executable

    def __enter__(self) -> NetworkTrainer:
        self.start()
        return self

    def __exit__(self, *_exception: object) -> None:
        self.close()

    def _die(self, reason: str) -> None:
        """End of the worker, whatever state it is in."""
        with self._news.changed:
            if not self._news.is_dead:
                self._news.note(state=TrainerState.DEAD, message=reason)
            child, self._child = self._child, None
            channel, self._channel = self._channel, None
            self._news.changed.notify_all()
        if child is not None:
            child.close()
        if self._reader is not None and self._reader is not threading.current_thread():
            self._reader.join(timeout=5.0)
        if child is not None:
            child.release()
        if channel is not None:
            channel.close()

    # Messages

    def _send(self, **message: Any) -> None:
        child = self._child
        if child is not None:
            child.send(**message)

    def _watch(self) -> None:
        """A worker that has said nothing for too long is hung."""
        if silence := self._news.silence():
            self._die(f"the training worker has not answered for {silence:.0f} s")

    # Use

    @property
    def status(self) -> TrainerStatus:
        """How training stands."""
        self._watch()
        with self._news.changed:
            return self._news.status

    @property
    def is_learning(self) -> bool:
        """Whether the worker has not learned all yet that there is to learn from: later snapshots will be better.

        On command it stops before the step that it was told to train to where more steps would learn noise.
        """
        status = self.status
        if self._on_command:
            return status.state is not TrainerState.DEAD and status.step >= self._told_step
        return status.state in (TrainerState.STARTING, TrainerState.WAITING, TrainerState.TRAINING)

    def submit(self, records: Records | Float32Array, row_count: int) -> int:
        """Hand over the records of an iteration; the worker's part of them, if there are more than it takes.

        Parameters
        ----------
        records : Records, or float32 (N, ROW_WIDTH)
            Rows for networks that guide (`training_rows.py`).
        row_count : int
            Rows in use. With `deterministic`, their order decides the result.

        Returns
        -------
        int
            Records handed over; 0 when the worker is dead, or still busy with the earlier ones (unless on command).
        """
        self._watch()
        if self._on_command:
            self._wait_for(lambda: bool(self._news.free_slots))
        with self._news.changed:
            if self._channel is None or row_count <= 0 or self._news.is_dead:
                return 0
            if not self._news.free_slots:
                self._news.note(dropped_submissions=self._news.status.dropped_submissions + 1)
                return 0
            slot = self._news.free_slots.pop()
            channel = self._channel
            self._submission_count += 1
            seed = self._seed * 0x9E3779B1 + self._submission_count
            taken = min(row_count, channel.slot_rows)
            count = channel.write_rows(slot, records, row_count, seed)
            self._news.note(
                submitted_rows=self._news.status.submitted_rows + count,
                rejected_rows=self._news.status.rejected_rows + taken - count,
            )
            self._send(kind="rows", slot=slot, count=count)
        return count

    def poll(self) -> Snapshot | None:
        """The newest snapshot that was not yet returned and is valid, else None."""
        self._watch()
        with self._news.changed:
            announced, self._news.announced = self._news.announced, None
            if announced is None or self._channel is None or self._news.is_dead:
                return None
            slot, version = announced
            snapshot = self._channel.read_snapshot(slot)
            if snapshot is None or snapshot.version < version:
                self._news.note(refused_snapshots=self._news.status.refused_snapshots + 1)
                return None
            try:
                snapshot.validate(self.shape)
            except ValueError as error:
                self._news.note(refused_snapshots=self._news.status.refused_snapshots + 1, message=str(error))
                return None
            return snapshot

    def train_until(self, step: int) -> Snapshot | None:
        """Train on what was submitted until `step` steps are done, and wait for it (on command only).

        Returns
        -------
        Snapshot or None
            None if the worker is dead, or there was no light to learn from.
        """
        if not self._on_command:
            raise ValueError("train_until needs a trainer that is deterministic or trains on command")
        with self._news.changed:
            self._news.trained_step = -1
            self._told_step = step
            self._send(kind="train", until=step)
        self._wait_for(lambda: self._news.trained_step >= 0)
        return self.poll()

    def _wait_for(self, condition: Callable[[], bool]) -> None:
        """Wait until `condition` or the worker's end."""
        while True:
            with self._news.changed:
                if condition() or self._news.status.state in (TrainerState.DEAD, TrainerState.OFF):
                    return
                self._news.changed.wait(timeout=0.5)
            self._watch()
