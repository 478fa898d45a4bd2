# SPDX-License-Identifier: GPL-3.0-or-later
"""By what a render asks its network: as the setting says, or what is faster; and what is said where that fails."""

from __future__ import annotations

import pytest

from engine.guiding.neural.models import network_backend
from engine.guiding.neural.models.network_backend import NetworkBackend, least_seconds, make_probe
from engine.guiding.neural.networks.radiance import COMPACT_SHAPE
from engine.guiding.neural.networks.radiance_query import make_network_field
from engine.settings import RenderSettings
from tests.helpers.failing_runtime import CPU, CUDA, FailingRuntime
from tests.helpers.radiance_networks import BOUNDS, random_snapshot

SNAPSHOT = random_snapshot(COMPACT_SHAPE)


def backend(name, **settings):
    return NetworkBackend(RenderSettings(network_backend=name, **settings), COMPACT_SHAPE)


def take(chosen):
    return chosen.take(SNAPSHOT, make_network_field(COMPACT_SHAPE, SNAPSHOT))


def test_the_kernel_needs_no_runtime(monkeypatch):
    FailingRuntime({}).install(monkeypatch)
    chosen = backend("KERNEL")
    assert take(chosen) is None and chosen.words == "the kernel" and chosen.take_notices() == []


def test_onnxruntime_is_asked_where_it_is_asked_for():
    chosen = backend("ONNXRUNTIME")
    assert take(chosen).provider and chosen.words == "onnxruntime on CPU" and chosen.take_notices() == []


@pytest.mark.parametrize("seconds, words", [((2.0, 1.0), "onnxruntime on CPU: "), ((1.0, 2.0), "the kernel: ")])
def test_auto_takes_what_is_faster_and_asks_the_clock_once(seconds, words, monkeypatch):
    asked = []
    monkeypatch.setattr(network_backend, "least_seconds", lambda calls: asked.append(len(calls)) or list(seconds))
    chosen = backend("AUTO")
    for _ in range(3):
        assert (take(chosen) is None) == (seconds[0] < seconds[1])
    assert asked == [2]
    assert chosen.words.startswith(words) and "us a candidate by the kernel" in chosen.words


def test_auto_measures_both():
    chosen = backend("AUTO")
    take(chosen)
    kernel, runtime = (float(word) for word in chosen.words.split() if word.replace(".", "").isdigit())
    assert kernel > 0.0 and runtime > 0.0 and (kernel <= runtime) == chosen.words.startswith("the kernel")


def test_auto_asks_no_clock_where_the_image_is_to_be_the_same(monkeypatch):
    monkeypatch.setattr(network_backend, "least_seconds", lambda calls: pytest.fail("it was timed"))
    chosen = backend("AUTO", deterministic=True)
    assert take(chosen) is None and chosen.words == "the kernel"


def test_auto_goes_on_with_the_kernel_where_onnxruntime_dies_while_it_is_timed(monkeypatch):
    FailingRuntime({CPU: 2}).install(monkeypatch)
    chosen = backend("AUTO")
    assert take(chosen) is None and take(chosen) is None
    (notice,) = chosen.take_notices()
    assert "CPU failed" in notice.problem and notice.fallback == "the kernel is asked"
    assert chosen.words.startswith("the kernel")


def test_each_failure_is_told_of_once(monkeypatch):
    FailingRuntime({CUDA: None, CPU: 99}).install(monkeypatch)
    chosen = backend("ONNXRUNTIME")
    assert take(chosen).provider == CPU and take(chosen).provider == CPU
    (notice,) = chosen.take_notices()
    assert "CUDA failed: no device" in notice.problem and notice.fallback == "the provider CPU is asked"
    assert chosen.take_notices() == []


def test_times_are_the_least_of_turns():
    times = iter([0.0, 3.0, 3.0, 4.0, 4.0, 5.0, 5.0, 9.0])
    assert least_seconds([lambda: True, lambda: True], 2, clock=lambda: next(times)) == [1.0, 1.0]
    assert least_seconds([lambda: False], repeats=0) == [float("inf")]


def test_probes_lie_within_the_bounds():
    probe = make_probe(BOUNDS, 10, per_vertex=4)
    assert probe.candidate_vertex.tolist() == [0, 0, 0, 0, 1, 1, 1, 1, 2, 2] and probe.positions.shape == (3, 3)
    assert (probe.positions >= BOUNDS[0]).all() and (probe.positions <= BOUNDS[1]).all()
