# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network through onnxruntime: what the kernel says, and what becomes of providers that fail."""

from __future__ import annotations

import dataclasses
import sys
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from engine.guiding.neural.networks.onnx_session import OLDEST, RadianceSession, RuntimeProviders
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE, NetworkShape
from tests.helpers.failing_runtime import CPU, CUDA, FailingRuntime
from tests.helpers.guiding_harness import random_directions
from tests.helpers.radiance_networks import predict, random_positions, random_snapshot

ROWS = 1000
SHAPES = {
    "compact": COMPACT_SHAPE,
    "paper": NetworkShape(),
    "wide": NetworkShape(width=128, table_size=1 << 12),
    "time by frequencies": dataclasses.replace(COMPACT_SHAPE, u_frequencies=4),
    "time by planes": dataclasses.replace(COMPACT_SHAPE, plane_levels=3, plane_resolution=4),
    "wavelengths": dataclasses.replace(COMPACT_SHAPE, channel_count=4, by_quarter=True, u_frequencies=2),
    "wavelengths that are not seen": dataclasses.replace(COMPACT_SHAPE, channel_count=4),
}


def lively_snapshot(shape):
    snapshot = random_snapshot(shape)
    shape.split(snapshot.parameters)["output_weights"][...] *= 30.0
    return snapshot


def probe(seed=3):
    """Positions, times, heroes, vertices and directions, in arrays longer than what is in use, as a thread's are."""
    rng = np.random.default_rng(seed)
    vertices = np.sort(rng.integers(0, ROWS // 3, ROWS + 9))
    positions = random_positions(rng, ROWS // 3 + 5, 1.3)
    time, hero = rng.random((2, ROWS // 3 + 5)).astype(np.float32)
    return positions, time, hero, vertices, random_directions(rng, ROWS + 9)


def ask(session, shape, points, rows=ROWS):
    out = np.full((ROWS + 9, shape.channel_count), -1.0, np.float32)
    return session.predict(*points, ROWS // 3, rows, out), out


@pytest.fixture
def expected():
    """By the kernel, for the compact shape."""
    return by_kernel(COMPACT_SHAPE, probe())


def by_kernel(shape, points):
    positions, time, hero, vertices, directions = points
    out = np.full((ROWS + 9, shape.channel_count), -1.0, np.float32)
    predict(shape, lively_snapshot(shape), positions, vertices[:ROWS], directions, out, time, hero)
    return out


@pytest.mark.parametrize("shape", SHAPES.values(), ids=SHAPES)
def test_onnxruntime_says_what_the_kernel_says(shape):
    points = probe()
    providers = RuntimeProviders()
    session = RadianceSession(providers, shape, lively_snapshot(shape))
    is_done, out = ask(session, shape, points)
    assert is_done and session.provider == CPU and providers.failures == []
    found = by_kernel(shape, points)
    assert np.log(found[:ROWS]).std() > 0.5
    np.testing.assert_allclose(out, found, rtol=2e-3)


def test_threads_may_ask_at_once(expected):
    session = RadianceSession(RuntimeProviders(), COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    points = probe()
    with ThreadPoolExecutor(4) as pool:
        for _, out in pool.map(lambda _: ask(session, COMPACT_SHAPE, points), range(16)):
            np.testing.assert_allclose(out, expected, rtol=2e-3)


def test_nothing_is_asked_of_no_candidates():
    session = RadianceSession(RuntimeProviders(), COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    is_done, out = ask(session, COMPACT_SHAPE, probe(), rows=0)
    assert is_done and (out == -1.0).all()


def test_a_provider_that_cannot_be_opened_is_passed_over(monkeypatch, expected):
    FailingRuntime({CPU: 99, CUDA: None}).install(monkeypatch)
    providers = RuntimeProviders()
    session = RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    assert session.provider == CPU
    (failure,) = providers.failures
    assert "CUDA" in failure.what and failure.why == f"no device for {CUDA}"
    np.testing.assert_allclose(ask(session, COMPACT_SHAPE, probe())[1], expected, rtol=2e-3)


def test_a_provider_that_is_quietly_replaced_is_told_of(monkeypatch):
    FailingRuntime({CUDA: 99, CPU: 99}, refused=(CUDA,)).install(monkeypatch)
    providers = RuntimeProviders()
    assert RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE)).provider == CPU
    assert "does not take it" in providers.failures[0].why


def test_the_next_provider_takes_over_from_one_that_dies(monkeypatch, expected):
    runtime = FailingRuntime({CUDA: 2, CPU: 99}).install(monkeypatch)
    providers = RuntimeProviders()
    session = RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    seen = []
    for _ in range(4):
        is_done, out = ask(session, COMPACT_SHAPE, probe())
        assert is_done
        np.testing.assert_allclose(out, expected, rtol=2e-3)
        seen.append(session.provider)
    assert seen == [CUDA, CUDA, CPU, CPU] and runtime.answered == 4
    assert len(providers.failures) == 1 and "has died" in providers.failures[0].why
    # A later snapshot does not try it again.
    assert RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE)).provider == CPU
    assert len(providers.failures) == 1


def test_without_a_provider_whoever_asks_is_told(monkeypatch):
    FailingRuntime({CPU: 1}).install(monkeypatch)
    providers = RuntimeProviders()
    session = RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    assert [ask(session, COMPACT_SHAPE, probe())[0] for _ in range(3)] == [True, False, False]
    assert session.provider == "" and len(providers.failures) == 1


def test_a_death_that_many_threads_meet_is_told_of_once(monkeypatch):
    FailingRuntime({CUDA: 3, CPU: 999}).install(monkeypatch)
    providers = RuntimeProviders()
    session = RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    with ThreadPoolExecutor(8) as pool:
        assert all(is_done for is_done, _ in pool.map(lambda _: ask(session, COMPACT_SHAPE, probe()), range(32)))
    assert len(providers.failures) == 1 and session.provider == CPU


@pytest.mark.parametrize(
    "runtime, what",
    [
        (None, "cannot be loaded"),
        (FailingRuntime({CPU: 9}, version=f"{OLDEST[0]}.{OLDEST[1] - 1}.3"), "too old"),
        (FailingRuntime({CPU: 9}, version="unknown"), "too old"),
    ],
)
def test_a_runtime_that_will_not_do(runtime, what, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", runtime)
    providers = RuntimeProviders()
    session = RadianceSession(providers, COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE))
    assert session.provider == "" and not ask(session, COMPACT_SHAPE, probe())[0]
    (failure,) = providers.failures
    assert what in failure.what and failure.why


def test_the_oldest_runtime_will_do(monkeypatch):
    FailingRuntime({CPU: 9}, version=f"{OLDEST[0]}.{OLDEST[1]}.0").install(monkeypatch)
    assert RadianceSession(RuntimeProviders(), COMPACT_SHAPE, lively_snapshot(COMPACT_SHAPE)).provider == CPU
