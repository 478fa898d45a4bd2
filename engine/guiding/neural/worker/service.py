# SPDX-License-Identifier: GPL-3.0-or-later
"""One training, served: takes records, trains within its share of time, publishes snapshots, answers.

Messages in (one JSON object a line): `rows` (slot, count), `train` (until: a step; on command only), `leave`.
Messages out: `ready`, `free` (slot), `progress` (step, loss, state), `snapshot` (slot, version), `trained` (step).
"""

from __future__ import annotations

import json
import math
import os
import queue
import threading
import time
from collections import deque
from typing import Any, TextIO

import numpy as np

from engine.guiding.neural.trainer.channel import FIRST_SLOT, SLOT_COUNT, Channel
from engine.guiding.neural.worker.kinds import KINDS, choose_device, make_training, rehearse
from engine.guiding.neural.worker.patience import Patience

#: Steps between two looks at the held-out records.
_CHECK_STEPS = 64
_HEARTBEAT = 1.0  # [s]


class Service:
    """One training, served.

    Parameters
    ----------
    config : dict
        As `NetworkTrainer` writes it.
    answers : text stream
    """

    def __init__(self, config: dict[str, Any], answers: TextIO) -> None:
        make_shape, make_settings = KINDS[config["kind"]]
        self.shape = make_shape(**config["shape"])
        self.settings = make_settings(**config["settings"])
        self.config = config
        self.channel = Channel.attach(self.shape, config["channel"])
        self._answers = answers
        self._answer_lock = threading.Lock()
        self._pending: deque[np.ndarray] = deque()
        self._commands: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()
        #: Set once the renderer has no more use for this training.
        self.is_over = threading.Event()
        self._began = time.process_time()
        #: What is trained; None before and after.
        self.training: Any = None

    def answer(self, kind: str, **fields: Any) -> None:
        """Send a message; a renderer that is gone is the end of this process too."""
        try:
            with self._answer_lock:
                self._answers.write(json.dumps({"kind": kind, **fields}) + "\n")
                self._answers.flush()
        except OSError:
            os._exit(0)

    def hear(self, message: dict[str, Any]) -> None:
        """Take a message, in the thread that reads them."""
        if message["kind"] == "rows":
            rows = self.channel.rows(message["slot"])[: message["count"]].copy()
            self.answer("free", slot=message["slot"])
            self._pending.append(rows)
            # Records that training did not come to are no reason to fill the memory.
            while sum(rows.shape[0] for rows in list(self._pending)) > self.settings.buffer_rows:
                self._pending.popleft()
        elif message["kind"] == "leave":
            self.is_over.set()
        self._commands.put(message)

    def run(self) -> None:
        """Train until the renderer has no more use for it."""
        config = self.config
        thread_count = 1 if config["deterministic"] else max(1, config["thread_count"])
        bounds = None if config["bounds"] is None else np.array(config["bounds"], np.float32)
        chosen = choose_device(
            self.shape, self.settings, thread_count, is_deterministic=config["deterministic"]
        )
        rehearse(self.shape, self.settings, thread_count, chosen.device)
        if self.is_over.is_set():
            # The render ended while this process started.
            return
        self.training = make_training(
            self.shape, self.settings, config["seed"], bounds, thread_count, chosen.device
        )
        first = self.channel.read_snapshot(FIRST_SLOT) if config["goes_on"] else None
        if first is not None:
            self.training.go_on_from(first)
        self.answer("ready", device=chosen.words, threads=thread_count)
        if config["on_command"]:
            self.train_on_command()
        else:
            self.train_freely(config["training_share"])

    def close(self) -> None:
        """Give back the memory, most of which is rows."""
        self.channel.close()
        self._pending.clear()
        self.training = None

    def take_pending(self) -> bool:
        """Hand arrived records to training."""
        arrived = False
        while self._pending:
            self.training.add(self._pending.popleft())
            arrived = True
        return arrived

    def publish(self) -> None:
        """Write a snapshot and say so."""
        if math.isnan(self.training.loss):
            self.training.improvement()
        snapshot = self.training.snapshot()
        slot = snapshot.version % SLOT_COUNT
        self.channel.write_snapshot(slot, snapshot)
        self.answer("snapshot", slot=slot, version=snapshot.version)

    def report(self, state: str) -> None:
        """Say how far training is, and that this process is alive."""
        training = self.training
        seconds = time.process_time() - self._began
        self.answer("progress", state=state, step=training.step_count, loss=training.loss, seconds=seconds)

    def has_budget(self) -> bool:
        """Whether there are records that training has not looked at often enough: more would learn their noise."""
        training = self.training
        looks = training.step_count * self.settings.batch_size
        return training.can_train and looks < training.looks_worth

    def train_on_command(self) -> None:
        """Train exactly as far as told, or as records are worth, on exactly those that came before."""
        while not self.is_over.is_set():
            try:
                message = self._commands.get(timeout=_HEARTBEAT)
            except queue.Empty:
                # The renderer may be compiling for minutes: silence would pass for death.
                self.report("IDLE" if self.training.can_train else "WAITING")
                continue
            if message["kind"] != "train":
                continue
            self.take_pending()
            told = time.monotonic()
            while self.has_budget() and self.training.step_count < message["until"] and not self.is_over.is_set():
                self.training.step()
                if time.monotonic() - told > _HEARTBEAT:
                    told = time.monotonic()
                    self.report("TRAINING")
            if self.training.can_train:
                self.training.improvement()
                self.publish()
            self.report("IDLE")
            self.answer("trained", step=self.training.step_count)

    def train_freely(self, share: float) -> None:
        """Train while records are fresh and the network improves, within `share` of the machine's processor time."""
        training = self.training
        allowance = share * (os.cpu_count() or 1)  # [s of processor time per s]
        patience = Patience()
        checked_step = 0
        published = told = time.monotonic()
        last_step = -1
        while not self.is_over.is_set():
            if self.take_pending():
                patience.wake()
                # What the next check compares with: that of before was found on other rows.
                training.improvement()
                checked_step = training.step_count
            has_work = not patience.is_resting and self.has_budget()
            now = time.monotonic()
            if not has_work:
                if training.can_train and training.step_count != last_step:
                    training.improvement()
                    self.publish()
                    last_step = training.step_count
                self.report("IDLE" if training.can_train else "WAITING")
                told = published = now
                self.wait(_HEARTBEAT)
                continue
            busy = time.process_time()
            training.step()
            if training.step_count - checked_step >= _CHECK_STEPS:
                patience.check(training.improvement())
                checked_step = training.step_count
            is_first = last_step < 0
            if now - published > (self.settings.first_snapshot_seconds if is_first else self.settings.snapshot_seconds):
                self.publish()
                last_step = training.step_count
                published = now
            if now - told > _HEARTBEAT:
                self.report("TRAINING")
                told = now
            busy = time.process_time() - busy
            excess = busy / max(allowance, 1e-3) - (time.monotonic() - now)
            if excess > 0.0:
                self.is_over.wait(min(excess, _HEARTBEAT))

    def wait(self, seconds: float) -> None:
        """Sleep until a message comes."""
        try:
            self._commands.get(timeout=seconds)
            while True:
                self._commands.get_nowait()
        except queue.Empty:
            pass
