# SPDX-License-Identifier: GPL-3.0-or-later
"""The rules of Blender's extensions site (docs/extension-rules.md), as far as the sources show that they are kept."""

from __future__ import annotations

import ast
import os
import re
import subprocess
import sys
import tomllib
import zipfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.blender_ranges import RANGES, ROOT
from tools.build_extension import build, download_wheels
from tools.extension_sizes import measure
from tools.staged_sources import stage_sources

#: Modules that install packages, and those that reach for the network.
INSTALLERS = {"ensurepip", "pip", "venv", "virtualenv"}
#: Where workers of a cluster find which address reaches the scheduler: the command line's `--cluster` alone starts any.
OF_CLUSTERS = {"engine/cluster/encryption.py"}
NETWORK = {"aiohttp", "ftplib", "http", "httpx", "requests", "smtplib", "socket", "socketserver", "ssl", "urllib"}

#: What may change `sys.path`: processes of our own, in which Blender does not run, and a checkout used as an add-on.
OWN_PATHS = {"engine/processes/__main__.py", "engine/render/precompile.py", "__init__.py"}

_CHANGES_PATH = re.compile(r"sys\.path(\[[^]]*\] *=[^=]|\.(append|extend|insert|remove|pop|clear)\b| *\+?=[^=])")


def imported(source: str) -> Iterator[str]:
    """Top-level packages that a source imports anywhere."""
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            yield from (alias.name.partition(".")[0] for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.level == 0:
            yield (node.module or "").partition(".")[0]


@pytest.fixture(scope="module")
def sources(tmp_path_factory: pytest.TempPathFactory) -> dict[str, str]:
    """Python sources as the extension holds them."""
    folder = tmp_path_factory.mktemp("stage") / "neuralguide"
    stage_sources(folder)
    found = {path.relative_to(folder).as_posix(): path.read_text("utf-8") for path in folder.rglob("*.py")}
    assert len(found) > 100
    return found


def test_changes_of_the_path_are_found() -> None:
    for source in ("sys.path.insert(0, x)", "sys.path[:] = x", "sys.path += [x]", "sys.path.append(x)"):
        assert _CHANGES_PATH.search(source), source
    for source in ("for entry in sys.path", "x = sys.path[0]", "sys.path[0] == x"):
        assert not _CHANGES_PATH.search(source), source


def test_nothing_is_installed_at_run_time(sources: dict[str, str]) -> None:
    assert [name for name, text in sources.items() if INSTALLERS & set(imported(text))] == []
    assert [name for name, text in sources.items() if re.search(r"[\"']pip[\"']|\bpip install\b", text)] == []


def test_nothing_reaches_for_the_network(sources: dict[str, str]) -> None:
    """So that `bpy.app.online_access` need not be asked, and no permission for the network."""
    assert {name for name, text in sources.items() if NETWORK & set(imported(text))} == OF_CLUSTERS


def test_only_processes_of_our_own_change_the_path(sources: dict[str, str]) -> None:
    assert {name for name, text in sources.items() if _CHANGES_PATH.search(text)} == OWN_PATHS
    # The extension has no such file, so that its `__init__.py` leaves the path alone.
    assert '(_FOLDER / "pyproject.toml").is_file()' in sources["__init__.py"]


def test_the_manifest_says_what_the_site_asks_for() -> None:
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    needed = {"schema_version", "id", "name", "tagline", "version", "type", "maintainer", "license", "tags"}
    assert needed <= set(manifest)
    assert re.fullmatch(r"\d+\.\d+\.\d+", manifest["version"]) and manifest["type"] == "add-on"
    assert len(manifest["tagline"]) <= 64 and manifest["tagline"][-1].isalnum()
    assert manifest["license"] == ["SPDX:GPL-3.0-or-later"]
    assert set(manifest["permissions"]) == {"files"}
    for reason in manifest["permissions"].values():
        assert len(reason) <= 64 and reason[-1].isalnum()


@pytest.mark.parametrize("blenders", RANGES, ids=lambda blenders: blenders.name)
def test_wheels_are_the_package_indexs_own(blenders, tmp_path: Path) -> None:
    """Byte for byte what was downloaded, under the same names."""
    path = build(blenders, "linux-x64", tmp_path, parts=())
    assert path is not None
    folder = ROOT / "build" / "wheels" / blenders.python / "linux-x64"
    wheels = download_wheels(blenders.python, "linux-x64", folder)
    with zipfile.ZipFile(path) as archive:
        held = {Path(name).name: archive.read(name) for name in archive.namelist() if name.endswith(".whl")}
        assert all(zipfile.is_zipfile(wheel) for wheel in wheels)
        assert held == {wheel.name: wheel.read_bytes() for wheel in wheels}
    assert measure(path).installed > measure(path).download > 0


_TOGGLE = """
import sys, threading
import bpy, addon
before = list(sys.path)
for _ in range(2):
    addon.register()
    from addon import warm_up
    warm_up.begin()
    addon.unregister()
print(sys.path == before, [thread.name for thread in threading.enumerate() if thread is not threading.main_thread()])
"""


def test_the_add_on_leaves_no_thread_and_no_path_behind(tmp_path: Path) -> None:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, "-c", _TOGGLE], env=environment, cwd=tmp_path, check=True, capture_output=True, text=True
    )
    assert done.stdout.strip().splitlines()[-1] == "True []", done.stdout + done.stderr
    assert list(tmp_path.iterdir()) == [], "something was written into the working folder"
