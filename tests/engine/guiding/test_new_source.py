# SPDX-License-Identifier: GPL-3.0-or-later
"""A source is a module and a line, a rung of AUTO is a line: one that tests define renders without bias as both."""

from __future__ import annotations

import ast
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from engine.guiding.policy.rules import Rules
from engine.methods import METHODS, SOURCES, Method, Source
from engine.settings import SETTINGS, Choice
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import pit_scene

pytestmark = pytest.mark.estimator

ROOT = Path(__file__).resolve().parents[3]
SEEDS = 6
RENDER = {"scene": pit_scene, "samples": 127, "max_bounces": 12, "diffuse_bounces": 12, "deterministic": True}


@pytest.fixture(autouse=True)
def cosine(monkeypatch: pytest.MonkeyPatch) -> None:
    """The lines of a new source, and of a rung that resamples what it proposes."""
    source = Source("COSINE", "Cosine", "About the normal", "examples.cosine_source")
    monkeypatch.setitem(SOURCES, "COSINE", source)
    monkeypatch.setitem(METHODS, "COSINE", Method("COSINE", "Cosine", "About the normal", "cosine", source="COSINE"))
    resampled = Method("COSINE_RIS", "Cosine, Resampled", "Weigh several", "resampled", source="COSINE", resamples=True)
    monkeypatch.setitem(METHODS, "COSINE_RIS", resampled)
    monkeypatch.setitem(METHODS, "AUTO", replace(METHODS["AUTO"], rungs=("COSINE", "COSINE_RIS")))
    # Settings take their choices from these tables when they are imported.
    for name in ("guiding_method", "source_field"):
        choices = (*SETTINGS[name].choices, Choice("COSINE", "", ""), Choice("COSINE_RIS", "", ""))
        monkeypatch.setitem(SETTINGS, name, replace(SETTINGS[name], choices=choices))


def means(method: str, **settings: object) -> np.ndarray:
    """Mean of the image by seed."""
    return np.array(
        [render(method, seed, **RENDER, **settings).passes["Combined"][..., :3].mean() for seed in range(SEEDS)]
    )


@pytest.fixture(scope="module")
def plain() -> np.ndarray:
    return means("OFF")


def test_by_name(plain: np.ndarray) -> None:
    found = means("COSINE", guiding_trial=False, learn_guiding_probability=False)
    assert z_score(found, plain) < Z_LIMIT
    assert z_score(1.02 * found, plain) > Z_LIMIT, "a bias of 2% would be seen"


def test_as_a_rung(plain: np.ndarray) -> None:
    """Resampling is taken to promise much, and the rung to win."""
    rules = Rules(
        least_resampled=-1.0, taken=(0.0, 0.0, 0.0), least_efficiency={3: 0.0, 4: 0.0}, least_of_short=0.0
    )
    found = [render("AUTO", seed, **RENDER, source_field="COSINE", rules=rules) for seed in range(SEEDS)]
    assert {result.report.guiding.chosen for result in found} == {"COSINE_RIS"}
    assert all("chose resampled" in "".join(result.report.guiding.lines) for result in found)
    images = np.array([result.passes["Combined"][..., :3].mean() for result in found])
    assert z_score(images, plain) < Z_LIMIT
    assert z_score(1.02 * images, plain) > Z_LIMIT, "a bias of 2% would be seen"


def test_the_example_for_scripts() -> None:
    """A process of its own, where the lines of the source come before the settings, and where there is no Blender."""
    without_blender = "import sys; sys.modules.update(bpy=None, mathutils=None)"
    script = f"{without_blender}; from examples import add_source; print(add_source.main())"
    done = subprocess.run([sys.executable, "-c", script], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = ast.literal_eval(done.stdout.splitlines()[-1])
    (plain, plain_noise), (by_cosine, noise) = found["OFF"], found["COSINE"]
    # Means of 6,144 pixels with about this noise each.
    assert abs(by_cosine / plain - 1.0) < Z_LIMIT * np.hypot(noise, plain_noise) / np.sqrt(96 * 64)
