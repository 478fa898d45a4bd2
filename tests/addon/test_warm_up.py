# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine is loaded ahead of the first render, where somebody sits and waits for it, and only there."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

_SCRIPT = """
import sys
import bpy, addon
from addon import warm_up
addon.register()
{body}
addon.unregister()
print("loaded" if "engine.render.session" in sys.modules else "untouched")
"""


def run(body: str, **variables: str) -> str:
    command = [sys.executable, "-c", _SCRIPT.format(body=body)]
    # Without byte code: none is made, whatever the checkout has.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONDONTWRITEBYTECODE": "1", **variables}
    done = subprocess.run(command, env=environment, cwd=ROOT, check=True, capture_output=True, text=True)
    return done.stdout.strip().splitlines()[-1]


@pytest.mark.parametrize(
    ("body", "expected"),
    [
        ("warm_up.begin(); warm_up.begin()", "loaded"),
        ("warm_up.start()", "untouched"),  # bpy is always in background
    ],
)
def test_the_engine_is_loaded_ahead_where_somebody_waits(body: str, expected: str) -> None:
    assert run(body) == expected


@pytest.mark.parametrize(("engine", "expected"), [("NEURALGUIDE", "loaded"), ("CYCLES", "untouched")])
def test_a_file_that_uses_the_engine_loads_it(tmp_path: Path, engine: str, expected: str) -> None:
    body = f"""
warm_up.start = warm_up.begin
bpy.context.scene.render.engine = {engine!r}
bpy.ops.wm.save_as_mainfile(filepath={str(tmp_path / "file.blend")!r})
bpy.ops.wm.read_factory_settings()
assert "engine.render.session" not in sys.modules
bpy.ops.wm.open_mainfile(filepath={str(tmp_path / "file.blend")!r})
"""
    assert run(body) == expected


def test_byte_code_is_made_once_and_whole(tmp_path: Path) -> None:
    """By the time the add-on is disabled, loading the engine writes none."""
    body = """
from pathlib import Path
def written():
    return {path for path in Path(sys.pycache_prefix).rglob("*.pyc") if {"engine", "numba"} & set(path.parts)}
assert warm_up.needs_byte_code() and len(warm_up._children) == 1
addon.unregister()
assert not warm_up.needs_byte_code()
made = written()
assert {path.name.partition(".")[0] for path in made} >= {"session", "rng", "scene", "dispatcher"}
warm_up.begin()
addon.unregister()
assert written() == made, written() - made
addon.register()
assert not warm_up._children
"""
    environment = {"PYTHONPYCACHEPREFIX": str(tmp_path), "PYTHONDONTWRITEBYTECODE": ""}
    assert run(body, **environment) == "loaded"
