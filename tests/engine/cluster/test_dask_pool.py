# SPDX-License-Identifier: GPL-3.0-or-later
"""Four workers on this machine: a guided picture is that of one process, whatever happens to them."""

from __future__ import annotations

import os
import signal
import threading
import time

import numpy as np
import pytest

from engine.render.session import Session
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene
from tests.helpers.waiting import wait_until

pytest.importorskip("distributed")
PASSES = ("Combined", "Variance", "Depth")
SETTINGS = RenderSettings(samples=15, guiding_method="VMM", deterministic=True, threads=1, seed=3)


@pytest.fixture(scope="module")
def pool():
    from engine.cluster.dask_pool import open_pool

    pool = open_pool("local:4", threads=1, silence=5.0)
    yield pool
    pool.close()


def by_one(settings, scene):
    session = Session(settings)
    session.load(scene)
    return session.render(passes=PASSES)


def by_cluster(pool, settings, scene, on_progress=None):
    from engine.cluster.session import ClusterSession

    session = ClusterSession(settings, pool, patience=2.0)
    session.load(scene)
    return session.render(passes=PASSES, on_progress=on_progress)


def is_same(a, b):
    return all(np.array_equal(a.passes[name], b.passes[name]) for name in PASSES)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="workers are stopped by signals")
def test_others_need_not_wait_for_a_scene_that_a_hung_worker_holds(pool):
    """All fetch it from the one that has it."""
    from engine.cluster.session import ClusterSession

    ids = pool.process_ids
    scene = corner_scene(size=(96, 64))
    session = ClusterSession(SETTINGS, pool, patience=2.0)
    session.load(scene)
    wait_until(lambda: bool(pool.holders))
    (holder,) = pool.holders
    os.kill(ids[holder], signal.SIGSTOP)
    try:
        result = session.render(passes=PASSES)
    finally:
        os.kill(ids[holder], signal.SIGCONT)
    assert is_same(result, by_one(SETTINGS, scene))
    assert [notice.subject for notice in result.report.notices if "gone" in notice.problem] == [
        f"Cluster, worker {holder}"
    ]


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="workers are stopped by signals")
def test_the_picture_is_one_machines_whatever_happens_to_workers(pool):
    """Whole; then with a worker that hangs from the first progress on; then with one more killed."""
    small = corner_scene(size=(32, 24))
    assert is_same(by_cluster(pool, SETTINGS, small), by_one(SETTINGS, small))
    scene = corner_scene(size=(96, 64))
    settings = SETTINGS
    wanted = by_one(settings, scene)
    ids = list(pool.process_ids.values())
    assert len(ids) == 4
    done = threading.Event()

    def hang(_progress):
        if not done.is_set():
            done.set()
            os.kill(ids[0], signal.SIGSTOP)

    result = by_cluster(pool, settings, scene, hang)
    assert is_same(result, wanted)
    os.kill(ids[0], signal.SIGCONT)
    done.clear()

    def kill(_progress):
        if not done.is_set():
            done.set()
            os.kill(ids[1], signal.SIGKILL)

    assert is_same(by_cluster(pool, settings, scene, kill), wanted)
    # The picture may be there before the scheduler has noticed.
    wait_until(lambda: len(pool.workers()) == 3)


@pytest.mark.slow
@pytest.mark.skipif(os.name != "posix", reason="workers are stopped by signals")
def test_a_worker_that_comes_back_goes_on_alone():
    """One that holds the scene hangs, the other one is to hold it and dies, and the first comes back."""
    from engine.cluster.dask_pool import open_pool
    from engine.cluster.session import ClusterSession

    pool = open_pool("local:2", threads=1, silence=2.0)
    ids = pool.process_ids
    first, second = ids
    steps = iter(("die", "return", ""))
    step = next(steps)

    def strike(_progress):
        nonlocal step
        if step == "die" and pool.workers() == {second}:
            os.kill(ids[second], signal.SIGKILL)
        elif step == "return" and not pool.workers():
            os.kill(ids[first], signal.SIGCONT)
        else:
            return
        step = next(steps)

    scene = corner_scene(size=(96, 64))
    deadline = time.monotonic() + 120.0
    try:
        session = ClusterSession(SETTINGS, pool, patience=2.0)
        session.load(scene)
        while pool.holders != {first}:
            first, second = second, first
            assert time.monotonic() < deadline
            time.sleep(0.1)
        os.kill(ids[first], signal.SIGSTOP)
        result = session.render(passes=PASSES, on_progress=strike, should_cancel=lambda: time.monotonic() > deadline)
    finally:
        os.kill(ids[first], signal.SIGCONT)
        pool.close()
    assert step == "" and is_same(result, by_one(SETTINGS, scene))


def test_without_certificates_the_reason_is_said_at_once(tmp_path):
    import dask

    from engine.cluster.dask_pool import open_pool, run_worker
    from engine.cluster.pool import ClusterError

    def fails(address, options, join=open_pool):
        started = time.monotonic()
        with (
            dask.config.set({f"distributed.comm.{key}": value for key, value in options.items()}),
            pytest.raises(ClusterError) as caught,
        ):
            join(address)
        assert time.monotonic() - started < 2.0
        return str(caught.value)

    (no_certificate := tmp_path / "words.pem").write_text("no certificate")
    nothing = {"tls.ca-file": None, "tls.client.cert": None, "tls.worker.cert": None}
    missing = nothing | {"tls.ca-file": str(no_certificate), "tls.client.cert": str(tmp_path / "missing.pem")}
    broken = missing | {"tls.client.cert": str(no_certificate), "tls.client.key": str(no_certificate)}
    secure, plain = "tls://127.0.0.1:9", "tcp://127.0.0.1:9"
    assert "TLS__CA_FILE names no file" in fails(secure, nothing)
    assert "TLS__CLIENT__CERT names" in fails(secure, missing) and "no such file" in fails(secure, missing)
    assert "cannot be used" in fails(secure, broken)
    assert "TLS__WORKER__CERT names no file" in fails(secure, missing, run_worker)
    assert "write tls://" in fails(plain, {"require-encryption": True})
