# SPDX-License-Identifier: GPL-3.0-or-later
"""The library is found where each Blender keeps it, and its absence is said in words."""

import importlib.util
import subprocess
import sys
from types import SimpleNamespace

import pytest

from engine.denoise.library import library_paths

#: Kinds of Blender: its Python, the package `bpy` if it is a package, and where the library is.
PLACES = {
    "Blender on Linux": ("blender/5.0/python/bin/python3.11", None, "blender/lib/libOpenImageDenoise.so.2"),
    "Blender on Windows": (
        "Blender 5.0/5.0/python/bin/python.exe", None, "Blender 5.0/blender.shared/OpenImageDenoise.dll",
    ),
    "Blender on macOS": (
        "Blender.app/Contents/Resources/5.0/python/bin/python3.11", None,
        "Blender.app/Contents/Resources/lib/libOpenImageDenoise.2.dylib",
    ),
    "bpy on Linux": ("venv/bin/python", "bpy", "bpy/lib/libOpenImageDenoise.so.2"),
    "bpy on Windows": ("venv/python.exe", "bpy", "bpy/OpenImageDenoise.dll"),
    "bpy on macOS": ("venv/bin/python", "bpy", "bpy/lib/libOpenImageDenoise.2.dylib"),
    "pyoidn on Linux": ("venv/bin/python", "pyoidn", "pyoidn/oidn/lib/libOpenImageDenoise.so.2"),
    "pyoidn on Windows": ("venv/python.exe", "pyoidn", "pyoidn/oidn/bin/OpenImageDenoise.dll"),
}  # fmt: skip


@pytest.mark.parametrize("place", PLACES)
def test_it_is_found_where_each_blender_keeps_it(place, tmp_path, monkeypatch):
    python, package, library = PLACES[place]
    for name in (python, library, *([f"{package}/__init__.py"] if package else ())):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    monkeypatch.setattr(sys, "executable", str(tmp_path / python))

    def find_spec(name):
        return SimpleNamespace(origin=str(tmp_path / name / "__init__.py")) if name == package else None

    monkeypatch.setattr(importlib.util, "find_spec", find_spec)
    monkeypatch.setattr(sys, "path", [])
    assert library_paths() == [tmp_path / library]


@pytest.mark.parametrize("is_broken", [False, True])
def test_without_it_the_reason_is_said(is_broken, tmp_path):
    """In a process of its own: it is looked for once."""
    path = tmp_path / "libOpenImageDenoise.so.2"
    path.write_text("no library", encoding="utf-8")
    program = f"""
import numpy as np
from engine.denoise import library
from engine.denoise.filter import denoise
from pathlib import Path
library.library_paths = lambda: [Path({str(path)!r})] * {int(is_broken)}
print(library.problem())
try:
    denoise(np.zeros((4, 4, 3), np.float32))
except library.DenoiserMissing as error:
    print(error)
"""
    shown = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout
    first, second = shown.splitlines()
    assert first == second
    assert first.startswith("Open Image Denoise was not found") and "pyoidn" in first
    assert ("libOpenImageDenoise.so.2" in first) == is_broken


def test_another_package_of_that_name_does_not_hide_it(tmp_path, monkeypatch):
    """Blender's scripts have a package `bpy` too, which comes first in processes that `bpy` has started."""
    scripts, site = tmp_path / "scripts", tmp_path / "site-packages"
    for name in (scripts / "bpy" / "__init__.py", site / "bpy" / "lib" / "libOpenImageDenoise.so.2"):
        name.parent.mkdir(parents=True)
        name.touch()
    found = SimpleNamespace(origin=str(scripts / "bpy" / "__init__.py"))
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: found if name == "bpy" else None)
    monkeypatch.setattr(sys, "path", [str(scripts), str(site)])
    monkeypatch.setattr(sys, "executable", str(tmp_path / "bin" / "python3"))
    assert library_paths() == [site / "bpy" / "lib" / "libOpenImageDenoise.so.2"]
