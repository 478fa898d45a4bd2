# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker that stands by: who gets it, that it trains as any other, that it is kept, and that it goes."""

from __future__ import annotations

import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, TrainableShape, TrainingSettings
from engine.guiding.neural.trainer import standby
from engine.guiding.neural.trainer.channel import Channel
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.neural.trainer.status import TrainerState
from engine.guiding.records.light import Records
from engine.guiding.records.training_rows import ROW_WIDTH
from engine.processes.child import Child
from tests.helpers.training import require_torch
from tests.helpers.waiting import NEVER, wait_until

pytestmark = pytest.mark.skipif(not standby.CAN_STAND_BY, reason="memory without a name cannot be opened here")

posix = pytest.mark.skipif(os.name != "posix", reason="signals")

BOUNDS = np.array([[-1.0] * 3, [1.0] * 3], np.float32)
SHAPE = NetworkShape(level_count=2, finest_resolution=16, table_size=1 << 8, width=16, hidden_layers=1)


@pytest.fixture(autouse=True)
def _none_is_left() -> Iterator[None]:
    standby.dismiss()
    yield
    standby.dismiss()


def end(worker: Child) -> None:
    worker.close()
    worker.release()
    assert worker.process.returncode is not None


def some_records(count: int) -> Records:
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(count, 3)).astype(np.float32)
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    ones = np.ones(count, np.float32)
    position = rng.uniform(-1.0, 1.0, (count, 3)).astype(np.float32)
    return Records(position, direction, np.ones((count, 3), np.float32), ones, ones, direction, ones, ones)


def some_rows(count: int) -> Float32Array:
    rows = np.random.default_rng(0).uniform(0.1, 1.0, (count, ROW_WIDTH)).astype(np.float32)
    for first in range(3, 12, 3):
        rows[:, first : first + 3] /= np.linalg.norm(rows[:, first : first + 3], axis=1, keepdims=True)
    return rows


def test_one_stands_by_and_one_gets_it() -> None:
    standby.stand_by()
    standby.stand_by()
    assert standby.take("another python") is None
    taken = standby.take(sys.executable)
    assert taken is not None and taken.worker.process.poll() is None
    assert standby.take(sys.executable) is None
    end(taken.worker)


def test_one_that_has_died_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = tmp_path / "ends.py"
    script.write_text("")
    started: list[Child] = []

    def launch(interpreter: str, config: dict[str, Any]) -> Child:
        started.append(Child(interpreter, "", config, script=script))
        return started[-1]

    with monkeypatch.context() as patched:
        patched.setattr(standby, "launch", launch)
        standby.stand_by()
    started[0].process.wait()
    assert standby.take(sys.executable) is None
    standby.stand_by()
    taken = standby.take(sys.executable)
    assert taken is not None
    end(taken.worker)


SETTINGS = TrainingSettings(batch_size=256)
#: Of another kind, so that nothing of it may be left.
OTHER_SHAPE = MixtureShape(position_encoding="BLOB")


def trained(shape: TrainableShape = SHAPE, steps: int = 4) -> tuple[Snapshot, int]:
    """A network after some steps, and the process that trained it."""
    settings = SETTINGS if shape is SHAPE else None
    rows = some_records(4000) if shape is SHAPE else some_rows(4000)
    with NetworkTrainer(shape, BOUNDS, deterministic=True, settings=settings) as trainer:
        assert trainer.process is not None
        process_id = trainer.process.pid
        assert trainer.submit(rows, 4000) == 4000
        snapshot = trainer.train_until(steps)
        assert trainer.status.state is not TrainerState.DEAD, trainer.status.message
    assert snapshot is not None and snapshot.step == steps
    return snapshot, process_id


def test_workers_started_kept_and_standing_by_train_the_same_network() -> None:
    require_torch()
    started, first = trained()
    _, second = trained(OTHER_SHAPE)
    kept, third = trained()
    assert first == second == third
    standby.dismiss()
    standby.stand_by()
    stood_by, fourth = trained()
    assert fourth != first
    for snapshot in (kept, stood_by):
        assert np.array_equal(snapshot.parameters, started.parameters)
        assert snapshot.version == started.version


def test_a_real_one_that_still_starts_trains_the_next_network() -> None:
    require_torch()
    with NetworkTrainer(SHAPE, BOUNDS, deterministic=True, settings=SETTINGS) as trainer:
        assert trainer.process is not None and trainer.status.state is TrainerState.STARTING
        first = trainer.process.pid
        assert trainer.submit(some_records(4000), 4000) == 4000
    kept, second = trained()
    assert first == second
    standby.dismiss()
    started, third = trained()
    assert third != first and np.array_equal(kept.parameters, started.parameters)


# What speaks the protocol without torch: a worker that is kept, and says of itself which training it is in.

STAND_IN = """
import json, sys
def answer(kind, **fields):
    print(json.dumps({"kind": kind, **fields}), flush=True)
sys.stdin.readline()
count = 0
for line in sys.stdin:
    kind = json.loads(line)["kind"]
    if kind == "job":
        count += 1
        answer("ready", device="cpu", threads=1)
        answer("progress", state="TRAINING", step=count, loss=0.5, seconds=0.0)
    elif kind == "leave":
        for late in range(100):
            answer("progress", state="TRAINING", step=1000, loss=0.5, seconds=0.0)
        answer("left")
"""


@pytest.fixture
def start(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[], NetworkTrainer]:
    """Starts a training by a stand-in, which is kept."""
    script = tmp_path / "worker.py"
    script.write_text(STAND_IN)
    monkeypatch.setattr(standby, "LEAVE_SECONDS", NEVER)

    def launch(interpreter: str, config: dict[str, Any], **_options: Any) -> Child:
        return Child(interpreter, "", config, script=script)

    monkeypatch.setattr(standby, "launch", launch)

    def start() -> NetworkTrainer:
        standby.stand_by()
        trainer = NetworkTrainer(SHAPE, BOUNDS, settings=SETTINGS, start_timeout=NEVER)
        trainer.start()
        return trainer

    return start


def process_of(trainer: NetworkTrainer) -> int:
    """The process that trains, once it does."""
    assert trainer.process is not None
    # It says that it is ready first, and then that it trains.
    wait_until(lambda: trainer.status.state not in (TrainerState.STARTING, TrainerState.WAITING))
    assert trainer.status.state is TrainerState.TRAINING, trainer.status.message
    return trainer.process.pid


def test_one_is_kept_for_training_after_training(start: Callable[[], NetworkTrainer]) -> None:
    found = set()
    for count in range(1, 4):
        with start() as trainer:
            found.add(process_of(trainer))
            # Not what the training before has said after its end.
            assert trainer.status.step == count
    assert len(found) == 1


def test_of_two_trainings_at_once_one_worker_is_kept(start: Callable[[], NetworkTrainer]) -> None:
    with start() as first, start() as second:
        processes = first.process, second.process
        assert process_of(first) != process_of(second)
    assert [process is not None and process.poll() is not None for process in processes] == [True, False]


#: The same, which is not through with starting before there is a file beside it.
SLOW_STAND_IN = STAND_IN.replace(
    "count = 0\n", "import os, time\nwhile not os.path.exists(__file__ + '.go'): time.sleep(0.01)\ncount = 0\n"
)


def test_one_that_still_starts_is_kept_too(start: Callable[[], NetworkTrainer], tmp_path: Path) -> None:
    """A short render, cancelled or over before its worker was ready, must not have the next one begin anew."""
    script = tmp_path / "worker.py"
    script.write_text(SLOW_STAND_IN)
    found = set()
    for _ in range(3):
        with start() as trainer:
            assert trainer.process is not None and trainer.status.state is TrainerState.STARTING
            found.add(trainer.process.pid)
    # Three trainings were left before they began: their memory is there until the worker has come to it.
    threads = [thread for thread in threading.enumerate() if thread.name == "training"]
    assert len(threads) == 3
    with start() as trainer:
        (tmp_path / "worker.py.go").touch()
        found.add(process_of(trainer))
        # What the worker says of the others is not this one's.
        assert trainer.status.step == 4
    assert len(found) == 1
    wait_until(lambda: not any(thread.is_alive() for thread in threads))


def test_memory_of_a_training_that_never_began_stays_until_its_worker_has_left_it(
    start: Callable[[], NetworkTrainer], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its descriptor would be another file's by then, and the worker would write into that."""
    (tmp_path / "worker.py").write_text(SLOW_STAND_IN)
    closed: list[Channel] = []
    monkeypatch.setattr(Channel, "close", lambda channel: closed.append(channel))
    with start():
        pass
    assert not closed
    (tmp_path / "worker.py.go").touch()
    wait_until(lambda: len(closed) == 1)
    closed[0].memory.close()


@posix
def test_one_that_still_starts_goes_when_it_is_dismissed(start: Callable[[], NetworkTrainer], tmp_path: Path) -> None:
    (tmp_path / "worker.py").write_text(SLOW_STAND_IN)
    with start() as trainer:
        process = trainer.process
    assert process is not None and process.poll() is None
    standby.dismiss()
    assert process.returncode is not None
    wait_until(lambda: not any(thread.name == "training" for thread in threading.enumerate()))


@posix
def test_after_one_that_was_killed_while_idle_another_is_started(start: Callable[[], NetworkTrainer]) -> None:
    with start() as trainer:
        process, first = trainer.process, process_of(trainer)
    os.kill(first, signal.SIGKILL)
    wait_until(lambda: process is not None and process.poll() is not None)
    with start() as trainer:
        assert process_of(trainer) != first


@posix
def test_after_one_that_hangs_while_it_leaves_another_is_started(
    start: Callable[[], NetworkTrainer], monkeypatch: pytest.MonkeyPatch
) -> None:
    with start() as trainer:
        first = process_of(trainer)
        os.kill(first, signal.SIGSTOP)
    monkeypatch.setattr(standby, "LEAVE_SECONDS", 0.5)
    with start() as trainer:
        assert trainer.process is not None and trainer.process.pid != first


@posix
def test_one_that_hangs_while_idle_costs_one_training(start: Callable[[], NetworkTrainer]) -> None:
    with start() as trainer:
        first = process_of(trainer)
    wait_until(lambda: not any(thread.name == "training" for thread in threading.enumerate()))
    os.kill(first, signal.SIGSTOP)
    with NetworkTrainer(SHAPE, BOUNDS, settings=SETTINGS, start_timeout=0.3) as trainer:
        wait_until(lambda: trainer.status.state is TrainerState.DEAD)
        assert "not answered" in trainer.status.message
    with start() as trainer:
        assert process_of(trainer) != first


# How it goes


def test_it_goes_when_it_has_been_idle_for_long(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Without torch, whose import takes longer than all else."""
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError(\"No module named 'torch'\", name='torch')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    monkeypatch.setattr(standby, "IDLE_SECONDS", 1.0)
    # Not by standing by: it may be gone before it is taken.
    worker = standby.launch(sys.executable, {"stands_by": True, "device": "AUTO"})
    wait_until(lambda: worker.process.poll() is not None)
    assert worker.process.returncode == 0
    end(worker)


def test_it_goes_when_its_input_ends() -> None:
    standby.stand_by()
    taken = standby.take(sys.executable)
    assert taken is not None
    worker = taken.worker
    worker.process.stdin.close()
    wait_until(lambda: worker.process.poll() is not None)
    assert worker.process.returncode == 0
    end(worker)


def test_dismissing_it_does_not_wait_until_it_is_ready(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Which this one never is."""
    (tmp_path / "torch.py").write_text("import time\nwhile True:\n    time.sleep(1.0)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    standby.stand_by()
    standby.dismiss()
    assert standby.take(sys.executable) is None
