# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels compiled by helper processes: all of them, once, cancellable, and not at all where there is no Python."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from engine.render import precompile
from engine.render.precompile_worker import small_scene
from engine.render.report import Progress
from engine.render.session import LoadCancelled, Session
from engine.settings import RenderSettings
from tests.helpers.warm_cache import QUICK_MODULES, cache_without

_RENDER = """
import json, sys
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.settings import RenderSettings
session = Session(RenderSettings(samples=7, threads=2, guiding_method=sys.argv[1], spectral=sys.argv[2]))
session.load(small_scene(), on_progress=lambda progress: print(progress.message))
result = session.render(passes=("Combined", "Albedo"))
assert result.passes["Combined"].mean() > 0.0
print("compiled", result.report.compile_seconds > 1.0)
"""


#: Writes which kernels a process asks its cache for: those of a part, or of a render.
_ASK = """
import sys
from pathlib import Path
from numba.core import sigutils
from engine.render import precompile
from engine.runtime.kernel_cache import KernelCache
from engine.runtime.kernel_library import kernel_key
folder, part = Path(sys.argv[1]), sys.argv[2]
asked = set()
load = KernelCache.load_overload
def note(cache, signature, context):
    arguments, _returned = sigutils.normalize_signature(signature)
    function = cache._function
    asked.add(f"{function.__module__}.{function.__qualname__} {kernel_key(function, arguments)}")
    return load(cache, signature, context)
KernelCache.load_overload = note
if part == "render":
    sys.argv[1:] = sys.argv[3:]
    exec(RENDER)
else:
    from engine.render.precompile_worker import compile_part
    precompile.stamp_file = lambda part: folder / f"{part}.complete"
    compile_part(part)
(folder / part).write_text("\\n".join(sorted(asked)))
""".replace("RENDER", repr(_RENDER))


@pytest.fixture
def cold(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty cache, for `precompile` and for the processes it starts."""
    monkeypatch.setenv("NEURALGUIDE_KERNEL_CACHE", str(tmp_path))
    return tmp_path


def machine_code(root: Path) -> set[str]:
    return {str(path.relative_to(root)) for path in root.rglob("*.nbc")}


def test_a_cold_cache_is_noticed(cold: Path) -> None:
    assert precompile.is_cold()
    for part in precompile.PARTS:
        precompile.stamp_file(part).touch()
    assert not precompile.is_cold()
    assert precompile.is_cold(precompile.GUIDED_PARTS)


def test_what_a_library_holds_is_not_compiled(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    library = SimpleNamespace(parts=frozenset(precompile.PARTS))
    monkeypatch.setattr(precompile, "kernel_library", lambda: library)
    assert not precompile.is_cold()
    assert precompile.is_cold(precompile.GUIDED_PARTS)


def test_cancel_ends_the_helpers(cold: Path) -> None:
    started: list[float] = []

    def should_cancel() -> bool:
        started.append(time.monotonic())
        return started[-1] - started[0] > 1.0

    messages: list[Progress] = []
    session = Session(RenderSettings(samples=1))
    with pytest.raises(LoadCancelled):
        session.load(small_scene(), should_cancel=should_cancel, on_progress=messages.append)
    assert messages[-1].message.startswith("Compiling kernels (once): ")
    assert f"of {sum(precompile.WORK[part].kernels for part in precompile.PARTS)} kernels" in messages[-1].message
    # Nobody holds the lock any more: the helpers are gone.
    with precompile.exclusive(precompile.PARTS[0]):
        # Nor have they been waited for.
        assert precompile.is_cold()
    with pytest.raises(RuntimeError, match="load a scene"):
        session.render()


#: Compiles as a session does, says so once helpers are started, and goes on.
_COMPILE = """
from engine.render import precompile
said = []
def say(_seconds):
    if not said:
        said.append(print("compiling", flush=True))
precompile.compile_ahead(say)
"""


@pytest.mark.skipif(os.name != "posix", reason="signals")
@pytest.mark.parametrize("number", ["SIGKILL", "SIGTERM"])
def test_helpers_end_with_whoever_started_them(cold: Path, number: str) -> None:
    """What they hold of a pipe is closed by their end alone: whoever reads it sees the last of them go."""
    reader, writer = os.pipe()
    start = f"import os; os.set_inheritable({writer}, True)\nimport subprocess; popen = subprocess.Popen\n"
    start += "subprocess.Popen = lambda *given, **named: popen(*given, **{**named, 'close_fds': False})\n"
    session = subprocess.Popen(
        [sys.executable, "-c", start + _COMPILE], env={**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)},
        stdout=subprocess.PIPE, pass_fds=(writer,),
    )  # fmt: skip
    os.close(writer)
    assert session.stdout is not None and session.stdout.readline() == b"compiling\n"
    session.send_signal(getattr(signal, number))
    session.wait()
    assert os.read(reader, 1) == b""  # for ever, if a helper stayed: compiling takes longer than tests may
    os.close(reader)
    session.stdout.close()
    assert precompile.is_cold()


def test_without_a_python_to_start_nothing_happens(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/opt/blender/blender")
    monkeypatch.setattr(sys, "prefix", str(cold))
    precompile.compile_ahead(lambda progress: pytest.fail("something was started"))
    assert precompile.is_cold()


def test_a_helper_that_fails_is_no_failure(cold: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    start = subprocess.Popen
    helpers: list[subprocess.Popen[bytes]] = []

    def start_failing(command: list[str], **options: Any) -> subprocess.Popen[bytes]:
        helpers.append(start([command[0], "-c", "raise SystemExit(3)"], **options))
        return helpers[-1]

    monkeypatch.setattr(subprocess, "Popen", start_failing)
    precompile.compile_ahead(lambda progress: None)
    assert [helper.returncode for helper in helpers] == [3] * len(precompile.PARTS)
    assert precompile.is_cold()


def test_inside_blender_its_python_is_found(cold: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    python = tmp_path / "bin" / f"python{sys.version_info.major}.{sys.version_info.minor}"
    python.parent.mkdir()
    python.touch()
    monkeypatch.setattr(sys, "prefix", str(tmp_path))
    monkeypatch.setattr(sys, "executable", "/opt/blender/blender")
    started: list[str] = []

    def note(command: list[str], **_options: Any) -> None:
        started.append(command[0])
        raise OSError("not in this test")

    monkeypatch.setattr(subprocess, "Popen", note)
    precompile.compile_ahead(lambda progress: None)
    assert started == [str(python)]


@pytest.mark.slow
def test_helpers_compile_everything_that_is_missing(tmp_path: Path) -> None:
    """A first process waits for the helpers and a second finds all there; neither compiles a kernel itself.

    Where nothing is there at first is tested with the extension (`tests/addon/test_extension.py`).
    """
    cold = cache_without(tmp_path / "kernels", QUICK_MODULES)
    there = machine_code(cold)
    environment = {
        **os.environ, "PYTHONPATH": os.pathsep.join(sys.path), "NEURALGUIDE_KERNEL_CACHE": str(cold),
    }  # fmt: skip

    def render() -> str:
        command = [sys.executable, "-c", _RENDER, "OFF", "OFF"]
        return subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout

    first = render()
    said = [tuple(map(int, found)) for found in re.findall(r"Compiling kernels \(once\): (\d+) of (\d+)", first)]
    done, totals = zip(*said, strict=True)
    assert list(done) == sorted(done) and len(set(done)) > 5, "it counts them while they are compiled"
    # What is told beforehand is what there is.
    assert set(totals) == {sum(precompile.WORK[part].kernels for part in precompile.PARTS)}
    assert "compiled True" in first
    made = machine_code(cold) - there
    assert len(made) > 10
    stamps = list(cold.glob("*.complete"))
    assert {path.name.rpartition("-")[0] for path in stamps} == set(precompile.PARTS)
    newest_stamp = max(path.stat().st_mtime for path in stamps)
    newest_kernel = max((cold / path).stat().st_mtime for path in made)
    assert newest_kernel <= newest_stamp + 0.1, "the first process had to compile something itself"
    second = render()
    assert "Compiling" not in second
    assert machine_code(cold) == there | made


@pytest.mark.slow
def test_parts_have_every_kernel_of_a_guided_render_with_wavelengths(tmp_path: Path) -> None:
    """Such a render needs every part. What earlier tests have compiled is not compiled again: all are asked for."""
    parts = (
        *precompile.PARTS, *precompile.GUIDED_PARTS, *precompile.SPECTRAL_PARTS, *precompile.SPECTRAL_GUIDED_PARTS,
    )  # fmt: skip
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path)}

    def asked_for(part: str, *arguments: str) -> set[str]:
        command = [sys.executable, "-c", _ASK, str(tmp_path), part, *arguments]
        subprocess.run(command, env=environment, check=True, capture_output=True)
        return set((tmp_path / part).read_text("utf-8").splitlines())

    compiled = {part: asked_for(part) for part in parts}
    needed = asked_for("render", "TABLE_RIS", "ON")
    assert len(needed) > 40 and needed - set().union(*compiled.values()) == set()
    # The test can fail: without the last part some are missing.
    assert needed - set().union(*(compiled[part] for part in parts[:-1]))
    # What users are told is to be compiled: what a part has, and no part before it.
    for number, part in enumerate(parts):
        new = compiled[part].difference(*(compiled[before] for before in parts[:number]))
        assert 0.8 * precompile.WORK[part].kernels < len(new) < 1.25 * precompile.WORK[part].kernels, part
