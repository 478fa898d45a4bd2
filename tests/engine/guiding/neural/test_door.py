# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that use no network load nothing of the networks, and are compiled for none."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.util import resolve_name
from pathlib import Path

import pytest

from engine.methods import SEQUENCE_TRAINING, SOURCES, TRAINED_PREDICTORS
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.runtime import kernel_cache
from engine.runtime.sources import imported_modules
from engine.settings import RenderSettings

ROOT = Path(__file__).resolve().parents[4]
#: AUTO is as short as renders that train nothing are.
_SCRIPT = """
import json, sys
from engine.guiding.models import training_process
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.settings import RenderSettings

def loaded():
    return sorted(name for name in sys.modules if name.startswith("engine.guiding.neural"))

found = {}
for method in ("OFF", "VMM", "AUTO"):
    session = Session(RenderSettings(samples=7, threads=1, guiding_method=method, guiding_trial=False))
    session.load(small_scene())
    assert session.render(passes=("Combined",)).passes["Combined"].mean() > 0.0
    session.close()
    found[method] = loaded()
training_process.dismiss()
found["the end"] = loaded()
from engine.guiding.sources import implementation
implementation("NPM")
found["a network"] = loaded()
print(json.dumps(found))
"""


def test_renders_without_networks_load_none() -> None:
    done = subprocess.run([sys.executable, "-c", _SCRIPT], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout.splitlines()[-1])
    assert found.pop("a network"), "the test would see them"
    assert found == {"OFF": [], "VMM": [], "AUTO": [], "the end": []}


@pytest.mark.parametrize("method", ["OFF", "VMM"])
def test_kernels_are_the_same_whatever_networks_there_are(method: str) -> None:
    """Settings of networks change no type: nothing is loaded or compiled for others."""

    def render(**settings: object) -> None:
        session = Session(RenderSettings(samples=3, threads=1, guiding_method=method, guiding_trial=False, **settings))
        session.load(small_scene())
        session.render(passes=("Combined",))
        session.close()

    render()
    before = kernel_cache.origins.copy()
    render(network_size="PAPER", network_backend="ONNXRUNTIME", mixture_preset="PAPER")
    assert kernel_cache.origins == before


def test_kernels_of_sources_are_compiled_anew_when_their_modules_change() -> None:
    """Names are no imports: the packages that they are found in say so."""
    sources = imported_modules("engine.guiding.sources", ROOT / "engine/guiding/sources/__init__.py")
    predictors = imported_modules("engine.guiding.models.predictors", ROOT / "engine/guiding/models/predictors.py")
    for name in (*(source.implementation for source in SOURCES.values()), SEQUENCE_TRAINING):
        assert resolve_name(name, "engine.guiding.sources") in sources
    for record in TRAINED_PREDICTORS.values():
        assert resolve_name(record.implementation, "engine.guiding.models") in predictors
