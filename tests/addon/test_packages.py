# SPDX-License-Identifier: GPL-3.0-or-later
"""Another add-on's packages, which Blender's Python has loaded before: a sentence that says whose they are."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

from addon import packages

ROOT = Path(__file__).resolve().parents[2]

#: A render in a process in which somebody has loaded a numba that lacks everything.
_RENDER = """
import sys, types
old = types.ModuleType("numba")
old.__version__, old.__file__ = "0.55.1", "/somewhere/numba/__init__.py"
sys.modules["numba"] = old
import bpy, addon
addon.register()
bpy.ops.wm.read_homefile()
bpy.context.scene.render.engine = "NEURALGUIDE"
bpy.context.scene.render.resolution_x = bpy.context.scene.render.resolution_y = 8
try:
    bpy.ops.render.render()
except RuntimeError:
    pass
from addon import engine
print([(outcome.status, outcome.message) for outcome in engine.outcomes])
"""


@pytest.mark.parametrize(
    ("version", "is_older"), [("0.55.1", True), ("0.67.9", True), ("0.68.0", False), ("1.0.0rc1", False), ("", False)]
)
def test_only_older_versions_are_named(version: str, is_older: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", SimpleNamespace(__version__=version, __file__="/there/numba.py"))
    said = packages.older_numba()
    assert bool(said) == is_older
    if is_older:
        assert f"numba {version} (from /there/numba.py)" in said and "disable that add-on" in said


def test_an_older_numba_is_a_sentence() -> None:
    done = subprocess.run([sys.executable, "-c", _RENDER], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    (line,) = [line for line in done.stdout.splitlines() if line.startswith("[(")]
    assert "FAILED" in line and "another add-on has loaded numba 0.55.1 (from /somewhere/numba/__init__.py)" in line
    assert "internal error" not in done.stdout


#: Enables the add-on where numba cannot be found.
_ENABLE = """
import importlib.util, sys
find = importlib.util.find_spec
importlib.util.find_spec = lambda name, *more: None if name == "numba" else find(name, *more)
import addon_utils
sys.path.insert(0, sys.argv[1])
print("ENABLED", addon_utils.enable("addon", handle_error=lambda error: print("SAID", error)))
"""


def test_a_blender_with_another_python_does_not_enable_it_and_says_what_to_do() -> None:
    command = [sys.executable, "-c", "import bpy\n" + _ENABLE, str(ROOT)]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    (said,) = [line for line in done.stdout.splitlines() if line.startswith("SAID")]
    assert "without its packages for Python 3." in said and "tools/install_legacy.py /usr/bin/blender" in said
    assert "ENABLED None" in done.stdout
