# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker that was started ahead of need: who gets it, that it trains as any other, and that it goes."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from engine.guiding.networks.radiance import NetworkShape, TrainingSettings
from engine.guiding.records.light import Records
from engine.guiding.trainer import standby
from engine.guiding.trainer.handle import NetworkTrainer, TrainerState
from engine.processes.child import Child

pytestmark = pytest.mark.skipif(not standby.CAN_STAND_BY, reason="memory without a name cannot be opened here")

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


def test_one_stands_by_and_one_gets_it() -> None:
    standby.stand_by()
    standby.stand_by()
    assert standby.take("another python") is None
    worker = standby.take(sys.executable)
    assert worker is not None and worker.process.poll() is None
    assert standby.take(sys.executable) is None
    end(worker)


def test_one_that_has_died_is_left_alone(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    script = tmp_path / "ends.py"
    script.write_text("")
    with monkeypatch.context() as patched:
        patched.setattr(standby, "launch", lambda interpreter, config: Child(interpreter, "", config, script=script))
        standby.stand_by()
    time.sleep(1.0)
    assert standby.take(sys.executable) is None
    standby.stand_by()
    worker = standby.take(sys.executable)
    assert worker is not None
    end(worker)


def test_a_trainer_takes_it_and_gets_the_same_network() -> None:
    settings = TrainingSettings(batch_size=256)
    found = []
    for stands_by in (False, True):
        if stands_by:
            standby.stand_by()
        with NetworkTrainer(SHAPE, BOUNDS, deterministic=True, settings=settings) as trainer:
            assert not stands_by or standby.take(sys.executable) is None
            assert trainer.submit(some_records(4000), 4000) == 4000
            snapshot = trainer.train_until(4)
            assert trainer.status.state is not TrainerState.DEAD, trainer.status.message
        assert snapshot is not None
        found.append(snapshot.parameters)
    assert np.array_equal(*found)


def test_it_goes_when_its_input_ends() -> None:
    standby.stand_by()
    worker = standby.take(sys.executable)
    assert worker is not None
    worker.process.stdin.close()
    deadline = time.monotonic() + 60.0
    while worker.process.poll() is None and time.monotonic() < deadline:
        time.sleep(0.05)
    assert worker.process.returncode == 0
    end(worker)


def test_dismissing_it_does_not_wait_until_it_is_ready() -> None:
    standby.stand_by()
    began = time.monotonic()
    standby.dismiss()
    assert time.monotonic() - began < 0.6
    assert standby.take(sys.executable) is None
