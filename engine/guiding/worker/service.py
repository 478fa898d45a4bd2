# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker's loop: takes records, trains within its share of time, publishes snapshots, answers.

Messages in (one JSON object a line): `rows` (slot, count), `train` (until: a step; on command only).
Messages out: `ready`, `free` (slot), `progress` (step, loss, state), `snapshot` (slot, version), `trained` (step),
`failed` (reason). When the input ends, the process does.
"""

from __future__ import annotations

import contextlib
import json
import math
import os
import queue
import sys
import threading
import time
from collections import deque
from typing import Any, BinaryIO, TextIO

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.networks.flow.shape import FlowSettings, FlowShape
from engine.guiding.networks.mixture.shape import NPM, MixtureSettings, MixtureShape
from engine.guiding.networks.radiance import COMPACT_SHAPE, NetworkShape, TrainingSettings
from engine.guiding.records.training_rows import ROW_WIDTH
from engine.guiding.trainer.channel import FIRST_SLOT, SLOT_COUNT, Channel
from engine.guiding.worker.patience import Patience
from engine.processes.parent import leave_with_parent

#: Steps between two looks at the held-out records.
_CHECK_STEPS = 64
_HEARTBEAT = 1.0  # [s]


#: What trains: shape and settings by the shape's kind.
_KINDS: dict[str, tuple[type, type]] = {
    NetworkShape.kind: (NetworkShape, TrainingSettings),
    MixtureShape.kind: (MixtureShape, MixtureSettings),
    FlowShape.kind: (FlowShape, FlowSettings),
}

#: What workers that stand by rehearse; other shapes are trained by the same kernels.
_USUAL_SHAPES = (COMPACT_SHAPE, NPM)


def _make_training(
    shape: Any, settings: Any, seed: int, bounds: Float32Array | None, thread_count: int, is_deterministic: bool
) -> tuple[Any, str]:
    """The training of a shape's kind, and the device it runs on. Imports torch, which takes seconds."""
    if isinstance(shape, MixtureShape):
        from engine.guiding.worker.mixture_training import MixtureTraining

        # Lobes and grids are small work for many kernels: a GPU would mostly wait.
        return MixtureTraining(shape, settings, seed, bounds, thread_count), "cpu"
    if isinstance(shape, FlowShape):
        from engine.guiding.worker.flow_training import FlowTraining

        return FlowTraining(shape, settings, seed, bounds, thread_count), "cpu"
    import torch

    from engine.guiding.worker.radiance_training import RadianceTraining

    device = "cuda" if not is_deterministic and torch.cuda.is_available() else "cpu"
    return RadianceTraining(shape, settings, seed, bounds, thread_count, device), device


def _rehearse(training: Any, row_width: int) -> None:
    """Have a training that is not used for anything else load (or compile) all its kernels."""
    rows = np.random.default_rng(0).uniform(0.1, 1.0, (256, row_width)).astype(np.float32)
    for first in range(3, 12 if row_width == ROW_WIDTH else 6, 3):
        rows[:, first : first + 3] /= np.linalg.norm(rows[:, first : first + 3], axis=1, keepdims=True)
    training.add(rows)
    training.step()
    training.improvement()
    training.snapshot()


def warm_up() -> None:
    """Import torch, and load the kernels of the usual trainings by training a little: all of it takes seconds."""
    # What is missing matters to whoever trains, who will hear of it.
    with contextlib.suppress(ImportError):
        for shape in _USUAL_SHAPES:
            arguments = (shape, shape.training_settings, 0, None, 1, True)
            _rehearse(_make_training(*arguments)[0], shape.row_width)


class Service:
    """One training, served.

    Parameters
    ----------
    config : dict
        As `NetworkTrainer` writes it.
    answers : text stream
    """

    def __init__(self, config: dict[str, Any], answers: TextIO) -> None:
        make_shape, make_settings = _KINDS[config["kind"]]
        self.shape = make_shape(**config["shape"])
        self.settings = make_settings(**config["settings"])
        self.config = config
        self.channel = Channel.attach(self.shape, config["channel"])
        self._answers = answers
        self._answer_lock = threading.Lock()
        self._pending: deque[np.ndarray] = deque()
        self._commands: queue.SimpleQueue[dict[str, Any]] = queue.SimpleQueue()

    def answer(self, kind: str, **fields: Any) -> None:
        """Send a message; a renderer that is gone is the end of this process too."""
        try:
            with self._answer_lock:
                self._answers.write(json.dumps({"kind": kind, **fields}) + "\n")
                self._answers.flush()
        except OSError:
            os._exit(0)

    def listen(self, stream: BinaryIO) -> None:
        """Read messages until there are no more (thread)."""
        for line in stream:
            message = json.loads(line)
            if message["kind"] == "rows":
                rows = self.channel.rows(message["slot"])[: message["count"]].copy()
                self.answer("free", slot=message["slot"])
                self._pending.append(rows)
                # Records that training did not come to are no reason to fill the memory.
                while sum(rows.shape[0] for rows in list(self._pending)) > self.settings.buffer_rows:
                    self._pending.popleft()
            self._commands.put(message)
        os._exit(0)

    def run(self) -> None:
        """Train until the input ends."""
        config = self.config
        thread_count = 1 if config["deterministic"] else max(1, config["thread_count"])
        bounds = None if config["bounds"] is None else np.array(config["bounds"], np.float32)
        arguments = (self.shape, self.settings, config["seed"], bounds, thread_count, config["deterministic"])
        _rehearse(_make_training(*arguments)[0], self.shape.row_width)
        self.training, device = _make_training(*arguments)
        first = self.channel.read_snapshot(FIRST_SLOT) if config["goes_on"] else None
        if first is not None:
            self.training.go_on_from(first)
        self.answer("ready", device=device, threads=thread_count)
        if config["on_command"]:
            self.train_on_command()
        else:
            self.train_freely(config["training_share"])

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
        self.answer(
            "progress", state=state, step=training.step_count, loss=training.loss, seconds=time.process_time()
        )

    def has_budget(self) -> bool:
        """Whether there are records that training has not looked at often enough: more would learn their noise."""
        training = self.training
        looks = training.step_count * self.settings.batch_size
        return training.can_train and looks < training.looks_worth

    def train_on_command(self) -> None:
        """Train exactly as far as told, or as records are worth, on exactly those that came before."""
        while True:
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
            while self.has_budget() and self.training.step_count < message["until"]:
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
        while True:
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
            if now - published > self.settings.snapshot_seconds:
                self.publish()
                last_step = training.step_count
                published = now
            if now - told > _HEARTBEAT:
                self.report("TRAINING")
                told = now
            busy = time.process_time() - busy
            excess = busy / max(allowance, 1e-3) - (time.monotonic() - now)
            if excess > 0.0:
                time.sleep(min(excess, _HEARTBEAT))

    def wait(self, seconds: float) -> None:
        """Sleep until a message comes."""
        try:
            self._commands.get(timeout=seconds)
            while True:
                self._commands.get_nowait()
        except queue.Empty:
            pass


def serve(config: dict[str, Any], stream: BinaryIO, answers: TextIO) -> None:
    """Run the service in this process; returns only if it failed, after saying why.

    One that is to stand by gets ready first, and the rest of its configuration in a line of its own.
    """
    if config.get("stands_by"):
        warm_up()
        line = stream.readline()
        if not line:
            return
        config = config | json.loads(line)
    service = None
    try:
        service = Service(config, answers)
        threading.Thread(target=service.listen, args=(stream,), daemon=True).start()
        leave_with_parent(config)
        service.run()
    except ModuleNotFoundError as error:
        reason = f"the package {error.name} is not installed for {sys.executable}"
    except MemoryError:
        reason = "out of memory"
    except Exception as error:
        # torch reports a failed allocation as a RuntimeError.
        reason = "out of memory" if "alloc" in str(error).lower() else f"{type(error).__name__}: {error}"
    else:
        return
    if service is None:
        answers.write(json.dumps({"kind": "failed", "reason": reason}) + "\n")
        answers.flush()
    else:
        service.answer("failed", reason=reason)
    os._exit(1)
