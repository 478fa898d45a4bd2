# SPDX-License-Identifier: GPL-3.0-or-later
"""The training worker seen from the renderer: what goes wrong costs a message, never a render, an orphan or a file.

Most workers here are stand-ins of a few lines that speak the protocol without torch.
"""

from __future__ import annotations

import importlib.util
import itertools
import mmap
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.guiding.neural.networks.flow.shape import FlowShape
from engine.guiding.neural.networks.mixture.shape import MixtureShape
from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, TrainingSettings, initial_parameters
from engine.guiding.neural.trainer import standby
from engine.guiding.neural.trainer.channel import Channel
from engine.guiding.neural.trainer.handle import NetworkTrainer
from engine.guiding.neural.trainer.status import TrainerState
from engine.guiding.records.light import allocate_records
from engine.processes import memory as memory_module
from tests.helpers.waiting import wait_until

SHAPE = NetworkShape(level_count=2, finest_resolution=16, table_size=1 << 8, width=16, hidden_layers=1)
SETTINGS = TrainingSettings(submission_rows=1000, batch_size=256)
BOUNDS = np.array(((0, 0, 0), (1, 1, 1)), np.float32)
ROOT = Path(__file__).resolve().parents[5]

posix = pytest.mark.skipif(os.name != "posix", reason="signals and descriptors")


def some_records(count=500, seed=0):
    rng = np.random.default_rng(seed)
    records = allocate_records(count)
    records.position[:] = rng.uniform(size=(count, 3))
    records.direction[:] = (0.0, 0.0, 1.0)
    records.radiance[:] = 1.0 + records.position[:, :1]
    return records


def snapshot(version, fill=None):
    parameters = initial_parameters(SHAPE, 0)
    if fill is not None:
        parameters[3] = fill
    return Snapshot(version, 10 * version, 0.5, 1.0, BOUNDS, parameters)


# Shared memory


def spoil(channel, published):
    """Change a byte of a snapshot's parameters where they lie in the memory."""
    with mmap.mmap(channel.memory.descriptor, Channel.size(SHAPE, channel.slot_rows)) as memory:
        start = memory.find(published.parameters.tobytes())
        assert start >= 0
        memory[start + 20] ^= 0xFF


def test_snapshots_cross_the_channel():
    host = Channel.create(SHAPE, SETTINGS)
    assert host.read_snapshot(0) is None
    for version in (1, 2):
        host.write_snapshot(version % 2, snapshot(version))
    read = host.read_snapshot(0)
    assert read.version == 2 and read.step == 20 and read.loss == 0.5 and np.array_equal(read.bounds, BOUNDS)
    assert np.array_equal(read.parameters, initial_parameters(SHAPE, 0))
    host.close()
    host.close()


def test_torn_snapshots_are_seen():
    host = Channel.create(SHAPE, SETTINGS)
    host.write_snapshot(1, snapshot(1))
    spoil(host, snapshot(1))
    assert host.read_snapshot(1) is None
    host.write_snapshot(1, snapshot(1))
    assert host.read_snapshot(1) is not None
    # A worker that goes while it writes.
    with pytest.raises(ValueError):
        host.write_snapshot(1, replace(snapshot(1), bounds=np.zeros(4, np.float32)))
    assert host.read_snapshot(1) is None
    host.close()


def test_records_cross_the_channel():
    host = Channel.create(SHAPE, SETTINGS)
    records = some_records(3000)
    assert host.write_rows(1, records, 3000, seed=5) == 1000
    assert host.rows(1).shape == (1000, SHAPE.row_width)
    positions = {tuple(p) for p in records.position.tolist()}
    assert all(tuple(row) in positions for row in host.rows(1)[:, :3].tolist())
    assert not host.rows(0).any()
    host.close()


@posix
def test_the_memory_has_no_name(tmp_path, monkeypatch):
    monkeypatch.setattr(memory_module.tempfile, "tempdir", str(tmp_path))
    before = set(os.listdir("/dev/shm")) if os.path.isdir("/dev/shm") else set()
    for missing in ((), ("memfd_create",)):
        for name in missing:
            monkeypatch.delattr(os, name, raising=False)
        host = Channel.create(SHAPE, SETTINGS)
        assert not list(tmp_path.iterdir())
        if os.path.isdir("/dev/shm"):
            assert not {name for name in set(os.listdir("/dev/shm")) - before if "neuralguide" in name}
        host.close()


def test_the_named_file_goes_with_the_channel(tmp_path, monkeypatch):
    """What systems without unnamed files get."""
    monkeypatch.setattr(memory_module.tempfile, "tempdir", str(tmp_path))
    monkeypatch.setattr(memory_module, "HAS_UNNAMED_FILES", False)
    host = Channel.create(SHAPE, SETTINGS)
    worker = Channel.attach(SHAPE, host.address)
    host.rows(0)[0, 0] = 7.0
    assert worker.rows(0)[0, 0] == 7.0
    worker.close()
    assert len(list(tmp_path.iterdir())) == 1
    host.close()
    assert not list(tmp_path.iterdir())


# Faults

HELLO = """
    import json, os, sys, time
    def answer(kind, **fields):
        print(json.dumps({"kind": kind, **fields}), flush=True)
    config = json.loads(sys.stdin.readline())
"""
READY = """
    answer("ready", device="cpu", threads=1)
"""
#: The worker's end of the shared memory.
ATTACH = """
    sys.path[:] = config["path"]
    from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, initial_parameters
    from engine.guiding.neural.trainer.channel import Channel
    shape = NetworkShape(**config["shape"])
    channel = Channel.attach(shape, config["channel"])
"""


@pytest.fixture
def trainer(tmp_path):
    """Makes trainers whose worker is a script or was started for them; closes them, and looks for what they left."""
    standby.dismiss()
    made, processes = [], []

    def make(*script, **options):
        handle = NetworkTrainer(SHAPE, BOUNDS, settings=SETTINGS, **options)
        if script:
            path = tmp_path / f"worker{len(made)}.py"
            path.write_text("".join(textwrap.dedent(part) for part in (HELLO, *script)))
            handle.script = path
        made.append(handle)
        handle.start()
        processes.append(handle.process)
        return handle

    yield make
    for handle, process in zip(made, processes, strict=True):
        handle.close()
        assert handle.status.state is TrainerState.DEAD
        if process is not None:
            assert process.returncode is not None, "the worker outlived its trainer"
    assert not [thread for thread in threading.enumerate() if thread.name == "training"]


def end_of(handle):
    wait_until(lambda: handle.status.state is TrainerState.DEAD)
    assert handle.submit(some_records(), 500) == 0
    assert handle.poll() is None
    return handle.status.message


def test_start_does_not_wait(trainer):
    handle = trainer("time.sleep(60)\n")
    assert handle.status.state is TrainerState.STARTING
    assert [handle.submit(some_records(), 500) for _ in range(4)] == [500, 500, 0, 0]
    assert handle.poll() is None
    assert handle.status.dropped_submissions == 2
    # Whoever waited for it would have waited for its end.
    assert handle.process.poll() is None


@posix
def test_killed_worker(trainer):
    handle = trainer(READY, "sys.stdin.read()\n")
    wait_until(lambda: handle.status.state is TrainerState.WAITING)
    os.kill(handle.process.pid, signal.SIGKILL)
    assert "SIGKILL" in end_of(handle)


def test_worker_that_ends(trainer):
    assert "code 3: no such luck" in end_of(trainer("print('no such luck', file=sys.stderr); sys.exit(3)\n"))


def test_worker_that_gives_up(trainer):
    assert "out of memory" in end_of(trainer(READY, "answer('failed', reason='out of memory')\nsys.exit(1)\n"))


@pytest.mark.parametrize("nonsense", ["print('hello', flush=True)", "answer('progress')", "print('[1]', flush=True)"])
def test_worker_that_talks_nonsense(trainer, nonsense):
    assert "nonsense" in end_of(trainer(READY, nonsense + "\n", "time.sleep(60)\n"))


def test_hung_worker(trainer):
    """It neither answers nor minds that its input has ended."""
    handle = trainer(READY, "import signal\nsignal.signal(15, signal.SIG_IGN)\ntime.sleep(60)\n", answer_timeout=0.3)
    assert "not answered" in end_of(handle)


def test_worker_that_never_starts(trainer):
    assert "not answered" in end_of(trainer("time.sleep(60)\n", start_timeout=0.3))


def test_missing_interpreter(trainer, tmp_path):
    handle = trainer(interpreter=str(tmp_path / "python"))
    assert "could not be started" in end_of(handle)


def test_no_shared_memory(trainer, monkeypatch):
    def refuse(*_arguments):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(memory_module.os, "posix_fallocate", refuse, raising=False)
    handle = trainer()
    assert handle.process is None
    assert "No space left" in end_of(handle)


def test_without_torch(trainer, tmp_path, monkeypatch):
    """The real worker, under a Python whose torch cannot be imported."""
    (tmp_path / "torch.py").write_text("raise ModuleNotFoundError(\"No module named 'torch'\", name='torch')\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path))
    assert "torch is not installed" in end_of(trainer())


def test_slow_worker_costs_records_only(trainer):
    handle = trainer(READY, "for line in sys.stdin:\n    pass\n")
    assert sum(handle.submit(some_records(), 500) > 0 for _ in range(5)) == 2
    assert handle.status.dropped_submissions == 3


def test_bad_snapshots_never_arrive(trainer):
    """The worker publishes one for each submission: a good one, one with NaN, a torn one, a good one."""
    publish = """
    import mmap
    import numpy as np
    answer("ready", device="cpu", threads=1)
    for version in (2, 4, 6, 8):
        slot = json.loads(sys.stdin.readline())["slot"]
        parameters = initial_parameters(shape, version)
        if version == 4:
            parameters[3] = np.nan
        made = Snapshot(version, 10 * version, 0.5, 1.0, np.array(config["bounds"], np.float32), parameters)
        channel.write_snapshot(0, made)
        if version == 6:
            with mmap.mmap(channel.memory.descriptor, Channel.size(shape, channel.slot_rows)) as memory:
                memory[memory.find(parameters.tobytes())] ^= 0xFF
        answer("snapshot", slot=0, version=version)
        answer("free", slot=slot)
        answer("progress", state="TRAINING", step=version, loss=0.5, seconds=0.0)
    sys.stdin.read()
    """
    handle = trainer(ATTACH, publish)

    def next_snapshot(version):
        handle.submit(some_records(), 500)
        wait_until(lambda: handle.status.step == version)
        return handle.poll()

    assert next_snapshot(2).version == 2
    assert handle.poll() is None
    assert next_snapshot(4) is None
    assert "not finite" in handle.status.message and handle.status.refused_snapshots == 1
    assert next_snapshot(6) is None
    assert handle.status.refused_snapshots == 2
    assert next_snapshot(8).version == 8


def test_a_trainer_says_whether_more_is_to_be_learned(trainer):
    assert trainer("time.sleep(60)\n").is_learning
    handle = trainer(READY, 'answer("progress", state="IDLE", step=9, loss=0.5, seconds=0.0)\nsys.stdin.read()\n')
    wait_until(lambda: handle.status.step == 9)
    assert not handle.is_learning


def test_on_command_more_is_to_be_learned_as_long_as_steps_are_worth_it(trainer):
    stops_at_9 = """
    for line in sys.stdin:
        message = json.loads(line)
        answer("progress", state="IDLE", step=min(message["until"], 9), loss=0.5, seconds=0.0)
        answer("trained", step=9)
    """
    handle = trainer(READY, stops_at_9, deterministic=True)
    for until, is_learning in ((4, True), (9, True), (12, False)):
        handle.train_until(until)
        assert handle.is_learning == is_learning


def test_two_trainers_do_not_meet(trainer):
    """Their workers look again and again at which slots of their memory have rows."""
    watch = """
    answer("ready", device="cpu", threads=1)
    for step in range(1, 10**6):
        filled = sum(channel.rows(slot).any() for slot in (0, 1))
        answer("progress", state="TRAINING", step=step, loss=float(filled), seconds=0.0)
        time.sleep(0.01)
    """
    first, second = (trainer(ATTACH, watch) for _ in range(2))
    wait_until(lambda: first.status.step > 0 and second.status.step > 0)
    assert first.status.loss == second.status.loss == 0.0
    first.submit(some_records(), 500)
    step = second.status.step
    wait_until(lambda: first.status.loss == 1.0 and second.status.step > step + 1)
    assert second.status.loss == 0.0


def alive(pid):
    try:
        os.kill(pid, 0)
    except ProcessLookupError:
        return False
    return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] != "Z"


@posix
@pytest.mark.skipif(not Path("/proc/self").exists(), reason="needs /proc")
@pytest.mark.parametrize("end", ["os.kill(os.getpid(), 9)", "pass", "raise RuntimeError", "trainer.close()"])
def test_worker_goes_with_its_renderer(tmp_path, end):
    """One that has been left while it starts too."""
    script = tmp_path / "renderer.py"
    script.write_text(
        textwrap.dedent(f"""
        import os, sys
        from engine.guiding.neural.trainer.handle import NetworkTrainer
        from engine.guiding.neural.networks.radiance import NetworkShape, TrainingSettings
        trainer = NetworkTrainer({SHAPE!r}, settings={SETTINGS!r})
        trainer.start()
        print(trainer.process.pid, flush=True)
        {end}
        """)
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "TMPDIR": str(tmp_path)}
    done = subprocess.run([sys.executable, script], capture_output=True, env=environment)
    wait_until(lambda: not alive(int(done.stdout)))
    assert [path.name for path in tmp_path.iterdir()] == ["renderer.py"]
    assert b"resource_tracker" not in done.stderr and b"leaked" not in done.stderr


# The real worker

needs_torch = pytest.mark.skipif(importlib.util.find_spec("torch") is None, reason="needs torch")


@needs_torch
def test_real_worker_trains_in_the_background():
    with NetworkTrainer(SHAPE, settings=SETTINGS, training_share=1.0) as trainer:
        received = None
        parts = itertools.count()

        def has_learned():
            """Whether a network of 20 steps or more is better than none.

            How many steps that takes depends on which records the worker has by then.
            """
            nonlocal received
            trainer.submit(some_records(1000, next(parts)), 1000)
            received = trainer.poll() or received
            assert trainer.status.state is not TrainerState.DEAD, trainer.status.message
            return received is not None and received.step >= 20 and received.loss < 1.0

        wait_until(has_learned)
        np.testing.assert_allclose(received.scale, 1.5, rtol=0.1)
        wait_until(lambda: trainer.status.state is TrainerState.IDLE)
    assert trainer.status.message == "closed"


@needs_torch
@pytest.mark.parametrize("shape", [SHAPE, MixtureShape(position_encoding="BLOB"), FlowShape()], ids=lambda s: s.kind)
def test_real_worker_waits_for_the_first_records(shape):
    with NetworkTrainer(shape) as trainer:
        wait_until(lambda: trainer.status.state is not TrainerState.STARTING)
        time.sleep(2.5)
        assert trainer.status.state is TrainerState.WAITING, trainer.status.message


@needs_torch
def test_real_worker_repeats_itself():
    """Deterministic: the same records, the same bits, whatever the machine does and how many threads it has."""
    results = []
    for threads in (1, 4):
        with NetworkTrainer(SHAPE, seed=3, settings=SETTINGS, deterministic=True, thread_count=threads) as trainer:
            for part in range(4):
                assert trainer.submit(some_records(1500, part), 1500) == 1000
                if part % 2:
                    result = trainer.train_until(5 * part)
        results.append(result)
    assert results[0].step == results[1].step == 15
    assert np.array_equal(results[0].parameters, results[1].parameters)


@needs_torch
def test_waiting_for_a_dead_worker_ends():
    # One that stood by would be done before it is killed.
    standby.dismiss()
    with NetworkTrainer(SHAPE, settings=SETTINGS, deterministic=True) as trainer:
        trainer.submit(some_records(), 500)
        threading.Timer(0.2, trainer.process.kill).start()
        assert trainer.train_until(10**9) is None
    assert trainer.submit(some_records(), 500) == 0
