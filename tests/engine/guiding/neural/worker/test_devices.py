# SPDX-License-Identifier: GPL-3.0-or-later
"""Training on a device: the same network as by the processor, to rounding, and the device that is faster.

A stand-in is the device: no GPU is needed, and none is tested.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.guiding.models.report import GuidingReport
from engine.guiding.neural.models import network_predictor, network_source
from engine.guiding.neural.networks.flow.shape import FlowSettings, FlowShape
from engine.guiding.neural.networks.mixture.shape import (
    NASG_PRODUCT,
    NASG_SETTINGS,
    NPM,
    NPM_OFFICIAL,
    NPM_PRODUCT,
    NPM_SETTINGS,
    MixtureSettings,
    MixtureShape,
)
from engine.guiding.neural.networks.radiance import NetworkShape, TrainingSettings
from engine.guiding.records.training_rows import (
    ROW_BSDF_PDF,
    ROW_GUIDE_PDF,
    ROW_PDF,
    ROW_RADIANCE,
    ROW_WIDTH,
)
from engine.guiding.sources import make_source_model
from engine.settings import RenderSettings
from tests.helpers.training import require_torch

torch = require_torch()

from engine.guiding.neural.worker import devices, kinds  # noqa: E402
from engine.guiding.neural.worker.adam import TABLE_EPSILON, Adam, Group  # noqa: E402
from engine.guiding.neural.worker.devices import GPU, PROCESSOR, Device, candidates, fastest  # noqa: E402
from engine.guiding.neural.worker.faults import DeviceError  # noqa: E402
from engine.guiding.neural.worker.row_weights import limit_outliers, row_weights  # noqa: E402
from engine.guiding.neural.worker.tables import LearnedTable  # noqa: E402
from engine.guiding.neural.worker.torch_weights import limit_outliers_torch, row_weights_torch  # noqa: E402
from tests.helpers.stand_in_device import STAND_IN  # noqa: E402

BOUNDS = np.array(((-1.0, -1.0, -1.0), (1.0, 1.0, 1.0)), np.float32)
BATCH = 512
_SMALL: dict[str, Any] = {"width": 16, "hidden_layers": 2}
RADIANCE = NetworkShape(level_count=2, finest_resolution=16, table_size=1 << 8, direction_bins=8, **_SMALL)


def mixtures() -> dict[str, tuple[MixtureShape, MixtureSettings]]:
    """Shapes that together have every encoding, target and way of drawing rows."""
    return {
        "npm": (replace(NPM_PRODUCT, **_SMALL), replace(NPM_SETTINGS, mis_compensation=True)),
        "official": (replace(NPM_OFFICIAL, **_SMALL), NPM_SETTINGS),
        "cosine": (replace(NPM, target="COSINE", plane_levels=2, u_frequencies=3, **_SMALL), NPM_SETTINGS),
        "hashes": (
            replace(
                NPM_PRODUCT, position_encoding="NONE", hash_levels=2, hash_resolution=3, hash_growth=2.0,
                hash_size=1 << 6, **_SMALL,
            ),
            NPM_SETTINGS,
        ),
        "nasg": (replace(NASG_PRODUCT, **_SMALL), NASG_SETTINGS),
    }  # fmt: skip


def cases() -> dict[str, tuple[Any, Any]]:
    """Shape and settings of every kind of training."""
    return {
        "radiance": (RADIANCE, TrainingSettings()),
        "radiance by u": (replace(RADIANCE, plane_levels=2, u_frequencies=3), TrainingSettings()),
        "radiance by quarter": (
            replace(RADIANCE, channel_count=4, u_frequencies=3, by_quarter=True), TrainingSettings(),
        ),
        "flow": (FlowShape(), FlowSettings()),
        "flow by chi-square": (FlowShape(), FlowSettings(target="RADIANCE", divergence="CHI2")),
        **mixtures(),
    }


def rows_of(shape: Any, count: int, seed: int = 0) -> Float32Array:
    """Rows with light from above, some black, and a few very bright."""
    rng = np.random.default_rng(seed)
    rows = rng.uniform(0.05, 1.0, (count, shape.row_width)).astype(np.float32)
    rows[:, :3] = rng.uniform(-1.2, 1.2, (count, 3))
    is_guide = shape.row_width == ROW_WIDTH and not isinstance(shape, NetworkShape)
    for first in range(3, 12 if is_guide else 6, 3):
        directions = rng.normal(size=(count, 3))
        rows[:, first : first + 3] = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    if not is_guide:
        rows[:, 6 : 6 + shape.channel_count] *= np.where(rows[:, [5]] > 0.0, 1.0, 0.1)
        if shape.by_quarter:
            rows[rng.random(count) < 0.5, 7] = np.nan
        return rows
    rows[:, ROW_RADIANCE] *= np.where(rows[:, 8] > 0.0, 5.0, 0.5) * (rng.random(count) < 0.8)
    rows[:: count // 7, ROW_RADIANCE] = 1e3
    rows[:, ROW_PDF] = rng.uniform(0.05, 3.0, count)
    rows[:, ROW_GUIDE_PDF] = np.where(rng.random(count) < 0.5, rng.uniform(0.01, 2.0, count), 0.0)
    rows[:, ROW_BSDF_PDF] = rng.uniform(0.0, 2.0, count)
    return rows


def training_of(name: str, device: Device) -> Any:
    shape, settings = cases()[name]
    # Rates at which rounding stays rounding: Adam's first steps go by the signs of gradients.
    settings = replace(settings, batch_size=BATCH, learning_rate=1e-3, table_learning_rate=1e-3)
    training = kinds.make_training(shape, settings, 3, BOUNDS, 1, device)
    training.add(rows_of(shape, 4000))
    return training


@pytest.mark.parametrize("name", cases())
def test_a_device_trains_the_network_of_the_processor(name: str) -> None:
    """Every row's features, weight and loss, and what steps make of the parameters, are the same to rounding."""
    processor, device = training_of(name, PROCESSOR), training_of(name, STAND_IN)
    rows = rows_of(processor.shape, 300, seed=1)
    ask = "density" if name.startswith("flow") else "predict"
    before = getattr(processor, ask)(rows)
    np.testing.assert_allclose(getattr(device, ask)(rows), before, rtol=2e-4, atol=2e-4)
    start = processor.snapshot().parameters.copy()
    for round_ in range(2):
        for _ in range(8):
            processor.step()
            device.step()
        for training in (processor, device):
            training.improvement()
        assert device.loss == pytest.approx(processor.loss, rel=2e-3, abs=2e-3)
        # Rows that come later are on the device too.
        more = rows_of(processor.shape, 2000, seed=5 + round_)
        processor.add(more)
        device.add(more)
    ours, theirs = device.snapshot().parameters, processor.snapshot().parameters
    assert ours.dtype == np.float32 and ours.shape == theirs.shape
    learned = np.linalg.norm(theirs - start)
    assert learned > 0.01 and np.linalg.norm(ours - theirs) < 0.03 * learned
    after = getattr(processor, ask)(rows)
    assert np.abs(getattr(device, ask)(rows) - after).mean() < 0.05 * np.abs(after - before).mean()


@pytest.mark.parametrize("name", mixtures())
def test_rows_weigh_the_same_on_a_device(name: str) -> None:
    shape, settings = mixtures()[name]
    rows = rows_of(shape, 1000)
    rows[:3, ROW_RADIANCE] = np.inf, 1e38, 0.0
    weights = row_weights_torch(shape, settings, torch.from_numpy(rows)).numpy()
    np.testing.assert_allclose(weights, row_weights(shape, settings, rows), rtol=1e-5)


@pytest.mark.parametrize("kept", [0.0, 0.75])
def test_outliers_are_cut_the_same_on_a_device(kept: float) -> None:
    rng = np.random.default_rng(4)
    cases = [np.zeros(100), np.ones(5), np.eye(1, 500)[0], rng.random(1000) ** 20.0, np.exp(rng.normal(0, 4, 2000))]
    for weights in cases:
        for share in (1e-4, 1e-2):
            cut = limit_outliers_torch(torch.from_numpy(weights), share, kept).numpy()
            np.testing.assert_allclose(cut, limit_outliers(weights, share, kept), rtol=1e-9, atol=1e-12)


def test_entries_without_a_gradient_are_left_alone_as_by_the_kernel() -> None:
    """Moments included: most of a table belongs to no record of a batch."""
    rng = np.random.default_rng(2)
    start = rng.normal(size=(40, 4)).astype(np.float32)
    tensor = torch.from_numpy(start.copy()).requires_grad_()
    adam = Adam([Group([tensor], 0.01, skips=True)], TABLE_EPSILON)
    table = start.copy()

    def backpropagate(*arguments: Any) -> None:
        gradient, out = arguments[4], arguments[-1]
        out += gradient

    learned = LearnedTable(table, backpropagate, level_count=1, learning_rate=0.01)
    for step in range(1, 20):
        gradient = rng.normal(size=start.shape).astype(np.float32)
        gradient[rng.random(40) < 0.6] = 0.0
        tensor.grad = torch.from_numpy(gradient.copy())
        adam.step()
        empty = np.zeros((0, 3), np.float32)
        learned.step(None, empty, empty[:, 0], gradient, step, lambda work, count: work(0, count))  # type: ignore[arg-type]
        np.testing.assert_allclose(tensor.detach().numpy(), table, rtol=1e-4, atol=1e-6)
    assert np.abs(table - start).max() > 0.05


# Which device


@pytest.fixture
def gpu(monkeypatch: pytest.MonkeyPatch) -> None:
    """There is a GPU: a stand-in."""
    monkeypatch.setattr(devices, "GPU", STAND_IN)
    monkeypatch.setattr(torch.cuda, "is_available", lambda: True)
    monkeypatch.setattr(kinds, "chosen_devices", {})
    monkeypatch.setattr(kinds, "rehearsed_shapes", set())


def test_what_is_asked_for_is_taken(gpu: None) -> None:
    assert candidates("AUTO", is_deterministic=False) == (PROCESSOR, STAND_IN)
    assert candidates("CPU", is_deterministic=False) == (PROCESSOR,)
    assert candidates("CUDA", is_deterministic=False) == (STAND_IN,)
    for wanted in ("AUTO", "CPU", "CUDA"):
        assert candidates(wanted, is_deterministic=True) == (PROCESSOR,)


def test_where_there_is_no_gpu_the_processor_is_taken_or_the_setting_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert candidates("AUTO", is_deterministic=False) == (PROCESSOR,)
    with pytest.raises(DeviceError, match="Training Device"):
        candidates("CUDA", is_deterministic=False)


def test_the_faster_one_is_taken_and_what_cannot_run_is_named() -> None:
    seconds = {PROCESSOR: 0.007, GPU: 0.022}
    assert fastest((PROCESSOR, GPU), seconds.__getitem__) == (PROCESSOR, "")
    assert fastest((GPU, PROCESSOR), {PROCESSOR: 0.2, GPU: 0.02}.__getitem__) == (GPU, "")

    def broken(device: Device) -> float:
        if device == GPU:
            raise RuntimeError("no kernel image is available")
        return 1.0

    choice = fastest((PROCESSOR, GPU), broken)
    assert choice.device == PROCESSOR and choice.words == "cpu (cuda failed: no kernel image is available)"
    with pytest.raises(RuntimeError, match="no kernel image"):
        fastest((GPU, GPU), broken)


@pytest.mark.parametrize("is_slower", [False, True])
def test_automatic_times_steps_on_both_once(gpu: None, monkeypatch: pytest.MonkeyPatch, is_slower: bool) -> None:
    """On rehearsed trainings, by a clock that says which of them takes longer."""
    stepped: list[bool] = []
    clock = [0.0]
    settings = TrainingSettings(batch_size=64)
    make = kinds.make_training

    def make_timed(*arguments: Any) -> Any:
        training, is_apart = make(*arguments), arguments[-1].is_apart
        step = training.step

        def timed() -> None:
            step()
            stepped.append(is_apart)
            clock[0] += 3.0 if is_apart == is_slower else 1.0

        training.step = timed
        return training

    class Time:
        @staticmethod
        def perf_counter() -> float:
            return clock[0]

    monkeypatch.setattr(kinds, "make_training", make_timed)
    monkeypatch.setattr(kinds, "time", Time)
    for _ in range(2):
        choice = kinds.choose_device(RADIANCE, settings, 1)
        assert choice.device == (PROCESSOR if is_slower else STAND_IN)
    assert len(stepped) >= 4 and stepped.count(True) == stepped.count(False) < 16
    # It is warm on what was chosen.
    stepped.clear()
    kinds.rehearse(RADIANCE, settings, 1, choice.device)
    assert not stepped


def test_the_worker_that_stands_by_is_warm_on_the_device_it_will_use(
    gpu: None, monkeypatch: pytest.MonkeyPatch
) -> None:
    warm: list[Any] = []
    make = kinds.make_training

    def noting(*arguments: Any) -> Any:
        warm.append(arguments[-1])
        return make(*arguments)

    monkeypatch.setattr(kinds, "make_training", noting)
    for wanted, expected in (("CUDA", {STAND_IN}), ("CPU", {PROCESSOR})):
        warm.clear()
        kinds.warm_up(wanted)
        assert set(warm) == expected


@pytest.mark.parametrize("method", ["NPM", "NASG", "FLOW", "NEURAL_RIS"])
def test_renders_train_on_the_device_of_their_settings(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []

    class Trainer:
        """Trains nothing."""

        def __init__(self, *_arguments: Any, **options: Any) -> None:
            asked.append(options["settings"].device)

        def start(self) -> None:
            pass

    for module in (network_source, network_predictor):
        monkeypatch.setattr(module, "NetworkTrainer", Trainer)
    for wanted in ("AUTO", "CUDA"):
        settings = RenderSettings(guiding_method=method, training_device=wanted)
        if method == "NEURAL_RIS":
            network_predictor.make_predictor(settings, GuidingReport(), []).begin(1)
        else:
            make_source_model(settings)
        assert asked.pop() == wanted
    with pytest.raises(ValueError, match="training_device"):
        RenderSettings(training_device="TPU")
