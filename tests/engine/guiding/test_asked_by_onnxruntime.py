# SPDX-License-Identifier: GPL-3.0-or-later
"""Whole renders whose radiance network is asked through onnxruntime: the kernel's image, also where that dies."""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.models.predictors import PREDICTORS, Predictions, Predictor
from engine.guiding.neural.models.radiance_model import RadianceModel
from engine.guiding.neural.networks.onnx_session import RadianceSession, RuntimeProviders
from engine.guiding.neural.networks.radiance import Snapshot, network_shape
from engine.guiding.neural.networks.radiance_query import make_network_field
from tests.helpers.failing_runtime import CPU, CUDA, FailingRuntime
from tests.helpers.seeded_renders import render
from tests.helpers.small_scenes import pit_scene
from tests.helpers.training import require_torch

SETTINGS = {
    "scene": pit_scene, "samples": 15, "threads": 2, "guiding_trial": False, "candidate_allocation": "FIXED",
    "candidate_count": 3,
}  # fmt: skip


def asked_by(monkeypatch, *, uses_session):
    """Have renders ask a network drawn at random; returns a list that gets the providers of each."""
    seen = []

    class Guess(Predictor):
        has_begun = is_ready = True
        predictions = Predictions()

        def __init__(self, settings, report, notices):
            super().__init__(settings, report, notices)
            shape = network_shape(settings)
            rng = np.random.default_rng(5)
            bounds = np.array(((-5.0, -5.0, -5.0), (5.0, 5.0, 5.0)), np.float32)
            parameters = rng.normal(0.0, 0.5, shape.parameter_count).astype(np.float32)
            snapshot = Snapshot(1, 1, 0.0, 1.0, bounds, parameters)
            providers = RuntimeProviders()
            seen.append(providers)
            session = RadianceSession(providers, shape, snapshot) if uses_session else None
            self.predictions = Predictions(model=RadianceModel(make_network_field(shape, snapshot), session))

    monkeypatch.setitem(PREDICTORS, "NETWORK", Guess)
    return seen


def image(**settings):
    return render("NEURAL_RIS", 3, **SETTINGS, **settings).passes["Combined"][..., :3]


def share_of_equal_pixels(a, b):
    return np.isclose(a, b, rtol=1e-3, atol=1e-5).all(axis=-1).mean()


@pytest.mark.parametrize("calls", [{CPU: 10**9}, {CPU: 5}, {CUDA: 5, CPU: 10**9}, {CUDA: 2, CPU: 3}])
def test_the_image_is_the_kernels_whoever_dies(calls, monkeypatch):
    """But for choices that float errors tip."""
    runtime = FailingRuntime(calls).install(monkeypatch)
    asked_by(monkeypatch, uses_session=False)
    expected = image()
    assert runtime.answered == 0
    (seen,) = [asked_by(monkeypatch, uses_session=True)]
    found = image()
    assert share_of_equal_pixels(found, expected) > 0.95
    dying = [provider for provider, count in calls.items() if count < 10**9]
    assert len(seen[0].failures) == len(dying)
    assert runtime.answered == sum(count for count in calls.values() if count < 10**9) or CPU not in dying
    assert runtime.answered > 4
    # The test can see another network: images are not alike for being of one scene.
    monkeypatch.setattr(np.random, "default_rng", lambda seed=None, old=np.random.default_rng: old(seed and seed + 1))
    asked_by(monkeypatch, uses_session=False)
    assert share_of_equal_pixels(image(), expected) < 0.9


def test_the_image_does_not_depend_on_the_number_of_threads(monkeypatch):
    asked_by(monkeypatch, uses_session=True)
    one, three = (render("NEURAL_RIS", 3, **{**SETTINGS, "threads": count}) for count in (1, 3))
    assert np.array_equal(one.passes["Combined"], three.passes["Combined"])


def test_a_trained_network_is_asked_and_a_death_is_told_of_once(monkeypatch):
    require_torch()
    runtime = FailingRuntime({CPU: 3}).install(monkeypatch)
    settings = {**SETTINGS, "samples": 31, "deterministic": True, "network_backend": "ONNXRUNTIME"}
    report = render("NEURAL_RIS", 1, **settings).report
    assert runtime.answered == 3
    (notice,) = [notice for notice in report.notices if "onnxruntime" in notice.problem]
    assert "has died" in notice.problem and notice.fallback == "the kernel is asked"
    assert "radiance network: asked by the kernel" in report.guiding.lines
    FailingRuntime({CPU: 10**9}).install(monkeypatch)
    report = render("NEURAL_RIS", 1, **settings).report
    assert report.notices == [] and "radiance network: asked by onnxruntime on CPU" in report.guiding.lines
