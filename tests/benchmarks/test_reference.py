# SPDX-License-Identifier: GPL-3.0-or-later
"""References and sweeps: means of seeds with an error of their own, refused where they do not belong, resumed."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.images import read_exr
from benchmarks.light_paths import differences
from benchmarks.reference import ReferenceFacts, load_reference, own_error
from benchmarks.rivals import Budget
from benchmarks.run import RivalResult
from benchmarks.sweep import budgets, reference_remarks
from tests.helpers.synthetic_records import grey, write_reference

SCENE = "builtin:film-box-filter"


def make(folder: Path, *more: str, samples: int = 4) -> int:
    return main(["reference", SCENE, "--samples", str(samples), "--threads", "1", "--out", str(folder), *more])


def facts(folder: Path) -> dict:
    return json.loads((folder / "film-box-filter.json").read_text(encoding="utf-8"))


@pytest.fixture(scope="module")
def made(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A reference of two seeds by Cycles, 20 x 15 pixels."""
    folder = tmp_path_factory.mktemp("references")
    assert make(folder, "--seeds", "2", "--pixels", "300") == 0
    return folder


def test_own_error_is_that_of_the_mean() -> None:
    rng = np.random.default_rng(1)
    images = [(2.0 + rng.normal(0.0, 0.2, (60, 80, 3))).astype(np.float32) for _ in range(4)]
    # Deviation 0.1 of the mean brightness; 14,400 values of 3 degrees of freedom: 0.7%, five of them allowed.
    assert own_error(images).whole == pytest.approx(0.1**2 / 1.01 / 4, rel=0.035)
    assert own_error(images).trimmed < own_error(images).whole
    assert math.isnan(own_error(images[:1]).whole)


def test_a_reference_is_the_mean_of_its_seeds_and_says_how_it_was_made(made: Path) -> None:
    seeds = [read_exr(made / "seeds" / "film-box-filter" / f"cycles_4spp_seed{seed}.exr")[0] for seed in (1, 2)]
    reference = load_reference(made, "film-box-filter")
    assert reference is not None and reference.facts is not None
    np.testing.assert_allclose(reference.image, np.mean(seeds, axis=0), rtol=1e-6)
    known = reference.facts
    assert (known.rival, known.samples, known.seeds, known.width, known.height) == ("cycles", 4, [1, 2], 20, 15)
    assert known.light_paths["max_bounces"] == 8 and known.light_paths["pixel_filter"] == "BOX"
    assert known.error == pytest.approx(own_error(seeds).whole) and 0.0 < known.error_trimmed <= known.error


def test_further_calls_add_seeds_and_never_take_any_away(made: Path, tmp_path: Path) -> None:
    folder = tmp_path / "grown"
    folder.mkdir()
    for file in made.rglob("*.*"):
        (folder / file.relative_to(made)).parent.mkdir(parents=True, exist_ok=True)
        (folder / file.relative_to(made)).write_bytes(file.read_bytes())
    before = (folder / "seeds" / "film-box-filter" / "cycles_4spp_seed1.json").stat().st_mtime_ns
    assert make(folder, "--seeds", "3", "--pixels", "300") == 0
    assert facts(folder)["seeds"] == [1, 2, 3]
    assert (folder / "seeds" / "film-box-filter" / "cycles_4spp_seed1.json").stat().st_mtime_ns == before
    assert make(folder, "--seeds", "1", "--pixels", "300") == 0
    assert facts(folder)["seeds"] == [1, 2, 3]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scene_hash": "other"}, "another version of the scene (other"),
        ({"light_paths": {"max_bounces": 3}}, "light paths are others"),
        ({"rival": "OFF"}, "made by OFF"),
        ({"samples": 8}, "with 8 samples"),
    ],
)
def test_seeds_are_not_added_to_something_else(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict, reason: str
) -> None:
    for name in ("film-box-filter.exr", "film-box-filter.json"):
        (tmp_path / name).write_bytes((made / name).read_bytes())
    (tmp_path / "film-box-filter.json").write_text(json.dumps({**facts(made), **change}), encoding="utf-8")
    assert make(tmp_path, "--seeds", "3", "--pixels", "300") == 2
    said = capsys.readouterr().err
    assert reason in said and "choose another folder" in said
    assert not (tmp_path / "seeds").exists(), "nothing was rendered"


def test_sweeps_go_step_by_step_and_are_taken_up_again(made: Path, tmp_path: Path) -> None:
    arguments = ["sweep", SCENE, "--rivals", "cycles", "--samples", "2", "1", "--seeds", "3", "--threads", "1"]
    arguments += ["--references", str(made), "--out", str(tmp_path)]
    assert main(arguments) == 0
    files = [tmp_path / step / "film-box-filter" / f"cycles_{step}_seed3.json" for step in ("1spp", "2spp")]
    records = [json.loads(file.read_text(encoding="utf-8")) for file in files]
    assert [record["samples"] for record in records] == [1, 2]
    # The reference gives the size.
    assert all((record["width"], record["height"]) == (20, 15) for record in records)
    results = json.loads((tmp_path / "sweep.json").read_text(encoding="utf-8"))["results"]
    assert [result["budget"] for result in results] == ["1spp", "2spp"]
    assert all(result["reference_error_trimmed"] > 0.0 and result["seed_error_trimmed"] > 0.0 for result in results)
    written = [file.stat().st_mtime_ns for file in files]
    files[1].unlink()
    assert main(arguments) == 0
    assert files[0].stat().st_mtime_ns == written[0] and files[1].stat().st_mtime_ns > written[1]
    assert main([*arguments, "--anew"]) == 0
    assert files[0].stat().st_mtime_ns > written[0]


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"scene_hash": "other"}, "another version of the scene"),
        ({"light_paths": {"max_bounces": 3}}, "max_bounces"),
    ],
)
def test_foreign_references_are_refused_before_anything_is_rendered(
    made: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], change: dict, reason: str
) -> None:
    references, out = tmp_path / "references", tmp_path / "out"
    references.mkdir()
    (references / "film-box-filter.exr").write_bytes((made / "film-box-filter.exr").read_bytes())
    (references / "film-box-filter.json").write_text(json.dumps({**facts(made), **change}), encoding="utf-8")
    common = ["--rivals", "cycles", "--samples", "1", "--seeds", "1", "--references", str(references)]
    assert main(["sweep", SCENE, *common, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert "the reference of film-box-filter does not fit cycles" in said and reason in said
    assert not out.exists()
    if "scene_hash" in change:
        assert main(["run", SCENE, *common, "--out", str(out)]) == 2
        assert reason in capsys.readouterr().err


def test_settings_that_are_not_known_do_not_differ() -> None:
    assert differences({}, {"max_bounces": 3}) == [] == differences({"max_bounces": 3}, {})
    assert differences({"max_bounces": 3}, {"max_bounces": 4}) == ["max_bounces 3 instead of 4"]


def test_torn_facts_are_named(tmp_path: Path) -> None:
    write_reference(tmp_path, grey())
    assert load_reference(tmp_path, "hall") is None and load_reference(None, "room") is None
    (tmp_path / "room.json").write_text("{", encoding="utf-8")
    with pytest.raises(ValueError, match=r"room\.json does not describe a reference"):
        load_reference(tmp_path, "room")
    (tmp_path / "room.json").unlink()
    found = load_reference(tmp_path, "room")
    assert found is not None and found.facts is None and found.problem("any", {}) == ""


def test_a_noisy_reference_is_told(tmp_path: Path) -> None:
    write_reference(tmp_path, grey(), error=0.02, error_trimmed=0.01)
    reference = load_reference(tmp_path, "room")
    assert reference is not None and isinstance(reference.facts, ReferenceFacts)
    good, bad = (
        RivalResult("room", name, 3, 4, 1.0, 0.0, 0.0, 1.0, 1.0, reference_error_trimmed=error)
        for name, error in (("cycles", 0.2), ("VMM", 0.05))
    )
    assert reference_remarks(reference, [good, bad]) == [
        "VMM: the reference's own error is 20% of what is measured (trimmed)"
    ]


def test_budgets_grow() -> None:
    assert budgets([64, 4, 4], []) == [Budget(4), Budget(64)]
    assert [str(step) for step in budgets([4], [8.0, 2.0])] == ["2s", "8s"]
