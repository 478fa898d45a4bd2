# SPDX-License-Identifier: GPL-3.0-or-later
"""The harness around the metrics: verdicts, tables, scene names, Cycles' clock, one short run from end to end."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks import parity, scenes, tables
from benchmarks.__main__ import main
from benchmarks.environment import describe
from benchmarks.images import read_exr
from benchmarks.rendering import RenderRecord
from benchmarks.rivals import Budget, find_rival, human_seconds
from benchmarks.run import RivalResult, result_table, summary_table
from benchmarks.scene_files import SceneSource, expand, scaled_size
from benchmarks.scenes import SCENES


def renders(seeds: range, factor: float = 1.0, deviation: float = 0.05) -> list[np.ndarray]:
    base = np.random.default_rng(99).uniform(0.5, 1.5, (64, 96, 4))
    base[..., 3] = 1.0
    images = []
    for seed in seeds:
        noise = np.random.default_rng(seed).normal(0.0, deviation, base.shape)
        noise[..., 3] = 0.0
        images.append((base * factor + noise).astype(np.float32))
    return images


def test_parity_calls_equal_pictures_the_same() -> None:
    result = parity.compare("x", renders(range(4)), renders(range(10, 14)), 64)
    assert result.verdict == "same"
    assert result.error_ratio == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("spoil", "reason"),
    [
        (lambda image: image * np.float32(1.02), "mean of RGBA"),
        (lambda image: image * np.array([1, 1, 1, 0.99], np.float32), "mean of A"),
        (lambda image: np.flip(image, axis=1), "cells"),
        (lambda image: image[:, ::2], "size"),
        (lambda image: np.where(np.indices(image.shape)[0] == 3, np.nan, image), "NaN"),
    ],
)
def test_parity_finds_what_is_planted(spoil, reason: str) -> None:
    ours = [np.ascontiguousarray(spoil(image)) for image in renders(range(4))]
    verdict = parity.compare("x", ours, renders(range(10, 14)), 64).verdict
    assert verdict.startswith("differs")
    assert reason in verdict


def test_parity_finds_more_noise_than_the_rival_has() -> None:
    result = parity.compare("x", renders(range(4), deviation=0.08), renders(range(10, 14)), 64)
    assert "error 2.5" in result.verdict or "error 2.6" in result.verdict


def test_parity_allows_a_documented_difference_and_no_more() -> None:
    ours, theirs = renders(range(4), 1.03), renders(range(10, 14))
    assert parity.compare("x", ours, theirs, 64, "a reason", 0.05).verdict == "as documented"
    assert parity.compare("x", ours, theirs, 64, "a reason", 0.02).verdict.startswith("differs")


def test_parity_admits_noise() -> None:
    deviation = 2.0
    result = parity.compare("x", renders(range(4), 1.0, deviation), renders(range(10, 14), 1.0, deviation), 64)
    assert result.verdict == "noisy"


def test_cycles_durations() -> None:
    assert human_seconds("00:01.25") == pytest.approx(1.25)
    assert human_seconds("01:02:03.50") == pytest.approx(3723.5)
    with pytest.raises(ValueError, match="not a duration"):
        human_seconds("soon")


def test_scaled_size_keeps_aspect_and_pixel_count() -> None:
    assert scaled_size(1920, 1080, 37_000) == (256, 144)
    assert scaled_size(100, 1, 4) == (20, 1)


def test_scene_arguments(tmp_path: Path) -> None:
    (tmp_path / "b.blend").touch()
    (tmp_path / "a.blend").touch()
    assert [s.name for s in expand([str(tmp_path), "builtin:light-s*"])][:3] == ["a", "b", "light-spot"]
    assert expand(["builtin:diffuse", "builtin:diffuse"]) == [SceneSource("builtin:diffuse")]
    with pytest.raises(ValueError, match="no scene builtin:nothing"):
        expand(["builtin:nothing"])
    with pytest.raises(ValueError, match="no file"):
        expand([str(tmp_path / "c.blend")])


def test_unknown_rival_is_named() -> None:
    with pytest.raises(ValueError, match="no rival 'luxcore'"):
        find_rival("luxcore")


def test_fast_gi_is_a_rival_that_leaves_the_next_one_without_it() -> None:
    import bpy

    for name, is_fast in (("cycles-fast-gi", True), ("cycles", False)):
        find_rival(name).configure(bpy.context.scene, Budget(samples=4), 0, 1)
        assert bpy.context.scene.cycles.use_fast_gi is is_fast


def test_a_scene_that_wants_fast_gi_has_it_by_every_rival() -> None:
    import bpy

    scene = bpy.data.scenes.new("Fast")
    scene.cycles.use_fast_gi = True
    for name in ("cycles-fast-gi", "cycles", "OFF"):
        find_rival(name).configure(scene, Budget(samples=4), 0, 1)
        assert scene.cycles.use_fast_gi
    bpy.data.scenes.remove(scene)


def test_tables_align_and_survive_nan() -> None:
    lines = tables.table(["a", "b"], [["x", 1.23456], ["long name", math.nan], ["y", 1234567.0]]).splitlines()
    assert len({len(line) for line in lines}) == 1
    assert "1.23 |" in lines[2]
    assert "- |" in lines[3]
    assert "1234567 |" in lines[4]
    assert tables.geometric_mean([1.0, 4.0, math.nan]) == pytest.approx(2.0)


def test_run_table_shows_ratios_to_the_first_rival() -> None:
    slow = RivalResult("s", "cycles", 3, 64, 2.0, 0.1, 0.0, 1e6, 500, 0.1, 0.08, efficiency=6.25)
    fast = RivalResult("s", "OFF", 3, 64, 1.0, 0.1, 5.0, 2.5e6, 600, 0.1, 0.04, efficiency=25.0)
    rows = [[cell.strip() for cell in line.split("|")] for line in result_table([slow, fast], "cycles").splitlines()]
    assert rows[3][rows[0].index("x speed")] == "2.5"
    assert rows[3][rows[0].index("x error")] == "2"
    assert rows[3][rows[0].index("x efficiency")] == "4"
    assert "2.5" in summary_table([slow, fast], "cycles").splitlines()[-1]


def test_resuming_keeps_only_the_same_work() -> None:
    def record(**changes: object) -> RenderRecord:
        values = {"scene": "s", "scene_hash": "h", "rival": "OFF", "seed": 1, "width": 9, "height": 9}
        values |= {"samples_asked": 4, "seconds_asked": 0.0, "threads": 2, "environment": describe()}
        return RenderRecord(**(values | changes))  # type: ignore[arg-type]

    assert record().is_same_work(record(), is_ours=True)
    for change in ({"seed": 2}, {"scene_hash": "i"}, {"threads": 1}, {"samples_asked": 5}, {"width": 8}):
        assert not record().is_same_work(record(**change), is_ours=True)
    older = record(environment={**describe(), "sources_hash": "older"})
    assert not older.is_same_work(record(), is_ours=True)
    assert older.is_same_work(record(), is_ours=False)


def test_every_builtin_scene_says_what_it_is() -> None:
    assert len(SCENES) > 100
    for name, scene in SCENES.items():
        assert scene.description != name, f"{name} has no docstring"
        assert scene.group in scenes.__all__


def test_budget_names_files() -> None:
    assert str(Budget(64)) == "64spp"
    assert str(Budget(1, 2.5)) == "2.5s"


def test_a_run_from_end_to_end(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["run", "builtin:film-box-filter", "--rivals", "cycles", "--samples", "2", "--seeds", "3"]
    arguments += ["--pixels", "300", "--threads", "1", "--out", str(tmp_path), "--resume"]
    assert main(arguments) == 0
    assert "film-box-filter" in capsys.readouterr().out
    record_file = tmp_path / "film-box-filter" / "cycles_2spp_seed3.json"
    record = json.loads(record_file.read_text(encoding="utf-8"))
    assert (record["width"], record["height"], record["samples"], record["threads"]) == (20, 15, 2, 1)
    assert record["wall_seconds"] == pytest.approx(
        record["render_seconds"] + record["export_seconds"] + record["compile_seconds"], abs=0.02
    )
    summary = json.loads((tmp_path / "summary.json").read_text(encoding="utf-8"))
    assert 0.0 < summary["results"][0]["seed_error_trimmed"] < 1.0
    written = record_file.stat().st_mtime_ns
    assert main(arguments) == 0
    assert record_file.stat().st_mtime_ns == written


def test_a_process_for_every_render_gives_the_same_picture(tmp_path: Path) -> None:
    arguments = ["run", "builtin:film-box-filter", "--rivals", "cycles", "--samples", "2", "--seeds", "1"]
    arguments += ["--pixels", "300", "--threads", "1"]
    assert main([*arguments, "--out", str(tmp_path / "same")]) == 0
    assert main([*arguments, "--out", str(tmp_path / "own"), "--isolate"]) == 0
    name = Path("film-box-filter") / "cycles_2spp_seed1.exr"
    same, own = (read_exr(tmp_path / folder / name)[0] for folder in ("same", "own"))
    np.testing.assert_allclose(own, same, rtol=1e-5)
    record = json.loads((tmp_path / "own" / name).with_suffix(".json").read_text(encoding="utf-8"))
    assert record["peak_memory_mib"] > 50.0 and record["render_seconds"] > 0.0


def test_blender_s_defaults_are_those_of_its_clamps(tmp_path: Path) -> None:
    arguments = ["run", "builtin:film-box-filter", "--rivals", "cycles", "--samples", "1", "--seeds", "1"]
    assert main([*arguments, "--pixels", "300", "--out", str(tmp_path), "--at-defaults"]) == 0
    record_file = tmp_path / "at-defaults" / "film-box-filter" / "cycles_1spp_seed1.json"
    record = json.loads(record_file.read_text(encoding="utf-8"))
    assert record["light_paths"]["clamp_indirect"] == 10.0


def test_bad_arguments_are_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["run", "builtin:nothing"]) == 2
    assert "no scene builtin:nothing" in capsys.readouterr().err
    assert main(["parity", "builtin:diffuse", "--seeds", "1"]) == 2
    assert "at least 2 seeds" in capsys.readouterr().err
