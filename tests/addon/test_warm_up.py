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


def run(body: str) -> str:
    command = [sys.executable, "-c", _SCRIPT.format(body=body)]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
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
