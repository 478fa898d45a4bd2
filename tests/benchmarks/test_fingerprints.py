# SPDX-License-Identifier: GPL-3.0-or-later
"""Fingerprints of pictures: the same code gives the same ones, and what changed is found and measured."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks import fingerprints
from benchmarks.__main__ import main
from benchmarks.fingerprint_cases import CASES
from engine.methods import METHODS
from engine.render.film import PASS_NAMES
from engine.render.report import RenderReport
from engine.scene.description import Notice
from engine.settings import RenderSettings

ROOT = Path(__file__).resolve().parents[2]


def taken(path: Path, *more: str, only: str = "passes") -> int:
    return main(["fingerprints", "--out", str(path), "--only", only, *more])


def paint(monkeypatch, value: float, **report: Any) -> None:
    """Let every case come to a picture of this value instead of a rendered one."""

    def render(case, pixels, threads):
        return {"Combined": np.full((2, 3, 4), value, np.float32)}, [RenderReport(**report)]

    monkeypatch.setattr(fingerprints, "render", render)


def test_every_method_has_a_case() -> None:
    """A method that is added must be added here too."""
    methods = {case.settings.get("guiding_method", "OFF") for case in CASES.values()}
    assert methods == set(METHODS)
    assert set(CASES["passes"].passes) == set(PASS_NAMES)


def test_cases_have_scenes_and_settings_that_there_are() -> None:
    from benchmarks.scenes import SCENES

    for case in CASES.values():
        assert case.scene in SCENES
        RenderSettings(**case.settings)


def test_the_same_code_gives_the_same_fingerprints(tmp_path: Path) -> None:
    """By processes of their own, so that none has compiled its kernels itself."""
    command = [sys.executable, "-m", "benchmarks", "fingerprints", "--only", "film-box", "vmm-transparent"]
    command += ["--pixels", "48", "--out"]
    for name, more in (("a", []), ("b", ["--against", str(tmp_path / "a.json")])):
        done = subprocess.run(
            [*command, str(tmp_path / f"{name}.json"), *more], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stdout + done.stderr
    assert "a.json: 0" in done.stdout
    image = json.loads((tmp_path / "a.json").read_text())["cases"]["film-box"]["images"]["Combined"]
    with np.load(tmp_path / "a.npz") as pictures:
        assert len(pictures) > 2
        assert image["mean"] == pytest.approx(pictures["film-box/Combined"].mean(), rel=1e-5)


def test_a_changed_picture_is_found_and_measured(tmp_path: Path, capsys, monkeypatch) -> None:
    paint(monkeypatch, 1.0)
    assert taken(tmp_path / "a.json") == 0
    assert taken(tmp_path / "b.json", "--against", str(tmp_path / "a.json")) == 0
    assert "a.json: 0" in capsys.readouterr().out
    paint(monkeypatch, 1.5)
    assert taken(tmp_path / "b.json", "--against", str(tmp_path / "a.json")) == 1
    said = capsys.readouterr().out
    assert "passes/Combined: max abs difference 0.5, relative RMS 0.5, 100.0% of the values" in said
    assert "a.json: 1" in said


def test_a_case_that_was_not_there_before_is_a_difference(tmp_path: Path, capsys, monkeypatch) -> None:
    paint(monkeypatch, 1.0)
    assert taken(tmp_path / "a.json") == 0
    assert taken(tmp_path / "b.json", "--against", str(tmp_path / "a.json"), only="film-box") == 1
    assert "film-box/Combined: new" in capsys.readouterr().out


def test_a_picture_that_depends_on_threads_is_found(tmp_path: Path, capsys, monkeypatch) -> None:
    def render(case, pixels, threads):
        images = {"Combined": np.full((2, 3, 4), threads, np.float32), "Depth": np.ones((2, 3, 1), np.float32)}
        return images, [RenderReport()]

    monkeypatch.setattr(fingerprints, "render", render)
    found, images = fingerprints.take(CASES["passes"], 48)
    assert found.thread_dependent == ["Combined"]
    assert images["Combined"].max() == 1.0
    assert taken(tmp_path / "a.json") == 1
    assert "Combined depends on the number of threads" in capsys.readouterr().out


def test_a_picture_of_a_guide_that_was_lost_is_no_fingerprint(tmp_path: Path, capsys, monkeypatch) -> None:
    paint(monkeypatch, 1.0, notices=[Notice("Guiding / NPM", "the training process ended", "the mixture guides")])
    assert taken(tmp_path / "a.json", only="method-npm") == 1
    assert "the training process ended" in capsys.readouterr().out


@pytest.mark.parametrize(("arguments", "reason"), [
    (["--only", "nothing"], "no case 'nothing'"),
    (["--only", "passes", "--against", "missing.json"], "no file that `fingerprints --out` wrote"),
])  # fmt: skip
def test_what_cannot_be_done_is_said_before_rendering(tmp_path: Path, capsys, arguments, reason: str) -> None:
    assert main(["fingerprints", "--out", str(tmp_path / "a.json"), *arguments]) == 2
    assert reason in capsys.readouterr().err
