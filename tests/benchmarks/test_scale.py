# SPDX-License-Identifier: GPL-3.0-or-later
"""`benchmarks scale`: what it measures, what it says, and that a render that fails is a line of the table."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from benchmarks import scale
from benchmarks.__main__ import main
from benchmarks.scale import CASES, ScaleRecord


def record(rival: str, peak: float, message: str = "") -> ScaleRecord:
    return ScaleRecord("4k", 3840, rival, 200.0, peak, 2.0, 1.0, 1.0, message)


def test_the_target_is_a_factor_and_a_slack() -> None:
    cycles = record("cycles", 1000.0)
    assert scale.is_within_memory(record("OFF", 1500.0), cycles)
    assert not scale.is_within_memory(record("OFF", 1501.0), cycles)


def test_the_table_says_who_keeps_to_the_target_and_what_failed() -> None:
    lines = scale.scale_table([record("OFF", 1000.0), record("cycles", 900.0)]).splitlines()
    assert len(lines) == 3 and lines[2].rstrip(" |").endswith("yes") and "3,840 pixels in a row" in lines[2]
    lines = scale.scale_table([record("OFF", 9000.0), record("cycles", 900.0)]).splitlines()
    assert lines[2].rstrip(" |").endswith("no")
    lines = scale.scale_table([record("OFF", float("nan"), "no room"), record("cycles", 900.0)]).splitlines()
    assert lines[2].rstrip(" |").endswith("no room")


def test_frames_have_their_size_by_their_count() -> None:
    assert CASES["8k"].frame(7680) == (7680, 4320)
    assert CASES["triangles"].frame(10) == (320, 240)


def test_small_scenes_are_measured_and_written(tmp_path: Path) -> None:
    arguments = ["scale", "--share", "0.0001", "--only", "instances", "--threads", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    stored = json.loads((tmp_path / scale.SCALE_FILE).read_text("utf-8"))["records"]
    assert [(item["rival"], item["count"]) for item in stored] == [("OFF", 10), ("cycles", 10)]
    assert all(item["peak_mib"] > item["scene_mib"] > 0.0 for item in stored)


def test_textures_are_files_of_their_own(tmp_path: Path) -> None:
    import bpy

    from benchmarks.scenes import growing

    growing.textures(3, tmp_path, 16)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["16-0.png", "16-1.png", "16-2.png", "16.png"]
    assert len(bpy.data.images) == 3 and all(tuple(image.size) == (16, 16) for image in bpy.data.images)


@pytest.mark.parametrize(("arguments", "said"), [(["--only", "weather"], "no scale of weather"),
                                                 (["--share", "0"], "a share of 0")])
def test_mistakes_are_sentences(arguments: list[str], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["scale", *arguments]) == 2
    assert said in capsys.readouterr().err
