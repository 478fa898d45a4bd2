# SPDX-License-Identifier: GPL-3.0-or-later
"""The page of charts: every figure on it against one worked out by hand, from records with planted errors."""

from __future__ import annotations

import json
import math
import re
from html import escape
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.environment import describe
from benchmarks.profiling import BARE_EMBREE_FILE
from benchmarks.report import figures
from benchmarks.report.collect import collect
from benchmarks.report.figures import BETTER_CYCLES, FLIP, MAPE, RELMSE, RELMSE_TRIMMED
from benchmarks.report.look import GLYPHS, LOOKS, look
from benchmarks.report.page import write_report
from benchmarks.report.pictures import Crop, choose_crop, colour_range, false_colour, file_name
from benchmarks.report.scaling_charts import scaling_section
from benchmarks.scaling_fit import SCALING_FILE, Curve
from tests.helpers.synthetic_records import HEIGHT, WIDTH, grey, write_line, write_reference, write_render

#: Of a picture whose every pixel is off by d where the truth is 1: (x - r)^2 / (r^2 + 0.01) and |x - r| / (r + 0.01).
DENOMINATOR = 1.01


class Page(HTMLParser):
    """What a test asks of a page: rows of its tables by caption, pictures, files it names, all its text."""

    def __init__(self, path: Path) -> None:
        super().__init__()
        self.rows: dict[str, list[list[str]]] = {}
        self.images: list[dict[str, str | None]] = []
        self.files: set[str] = set()
        self.text = ""
        self._caption: str | None = None
        self._inside = ""
        self.feed(path.read_text(encoding="utf-8"))

    def handle_starttag(self, tag, attrs) -> None:
        values = dict(attrs)
        if tag == "img":
            self.images.append(values)
        for name in ("src", "srcset", "data-picture", "data-error"):
            if values.get(name):
                self.files.add(values[name])
        if tag == "caption":
            self._caption = ""
        if tag == "tr" and self._caption is not None:
            self.rows.setdefault(self._caption, []).append([])
        if tag in ("th", "td") and self._caption is not None:
            self.rows[self._caption][-1].append("")
        self._inside = tag if tag in ("caption", "script", "style") else self._inside

    def handle_endtag(self, tag) -> None:
        self._inside = "" if tag == self._inside else self._inside
        if tag == "table":
            self._caption = None

    def handle_data(self, data) -> None:
        if self._inside == "caption":
            self._caption = (self._caption or "") + data
        elif self._caption is not None and self.rows.get(self._caption):
            self.rows[self._caption][-1][-1] += data
        elif self._inside not in ("script", "style"):
            self.text += data

    def table(self, beginning: str) -> list[list[str]]:
        """Rows below the head of the table whose caption begins so, without the rivals' marks."""
        caption = next(name for name in self.rows if name.startswith(beginning))
        marks = "".join(GLYPHS.values())
        return [[cell.lstrip(marks).strip() for cell in row] for row in self.rows[caption]]


def off_by(error: float, seed: int) -> np.ndarray:
    """Nine tenths of the error, the error, eleven tenths: by seed."""
    return grey(1.0 + error * (0.8 + 0.1 * seed))


def around(error: float, seed: int) -> np.ndarray:
    """Values about 1 whose variance over the three seeds is error^2."""
    return grey(1.0 + error * (seed - 2))


@pytest.fixture(scope="module")
def page(tmp_path_factory: pytest.TempPathFactory) -> tuple[Page, Path]:
    """Cycles both ways and two of ours, two budgets, against a reference of ones."""
    folder = tmp_path_factory.mktemp("report")
    write_line(folder / "sweep", "cycles", {1.0: 0.4, 4.0: 0.2}, off_by)
    write_line(folder / "sweep", "cycles-guided", {1.0: 0.4, 4.0: 0.1}, off_by)
    write_line(folder / "sweep", "OFF", {1.0: 0.2, 4.0: 0.1}, off_by, rays={"closest": 2_000_000, "shadow": 1_000_000})
    (folder / "sweep" / BARE_EMBREE_FILE).write_text('{"room": 3e6}', encoding="utf-8")
    learned = {"learning": {"stopped_at": 20, "field_seconds": 1.0, "training_seconds": 0.5}}
    stages = {"stage_seconds": {"intersect_closest": 2.0, "scatter": 3.0, "draw_candidates": 0.25}}
    write_line(folder / "sweep", "VMM", {1.0: 0.2, 4.0: 0.05}, off_by, details={**learned, **stages})
    write_reference(folder / "references", grey(), error=1e-3, error_trimmed=1e-3)
    path = write_report(folder / "sweep", folder / "page", folder / "references")
    return Page(path), path


def test_errors_on_the_page_are_those_planted(page: tuple[Page, Path]) -> None:
    read, path = page
    stored = json.loads((path.parent / "report.json").read_text(encoding="utf-8"))["scenes"]["room"]
    for point in stored:
        d = {"cycles": {"1s": 0.4, "4s": 0.2}, "cycles-guided": {"1s": 0.4, "4s": 0.1}, "OFF": {"1s": 0.2, "4s": 0.1},
             "VMM": {"1s": 0.2, "4s": 0.05}}[point["rival"]][point["budget"]]  # fmt: skip
        low, centre, high = point["errors"][RELMSE]
        assert (low, centre, high) == pytest.approx([(f * d) ** 2 / DENOMINATOR for f in (0.9, 1.0, 1.1)], rel=1e-4)
        assert point["errors"][RELMSE_TRIMMED] == pytest.approx(point["errors"][RELMSE])
        assert point["errors"][MAPE] == pytest.approx([f * d / DENOMINATOR for f in (0.9, 1.0, 1.1)], rel=1e-4)
        assert 0.0 < point["errors"][FLIP][0] <= point["errors"][FLIP][1] <= point["errors"][FLIP][2]
        # The seeds are (0.9, 1, 1.1) d: a variance of (0.1 d)^2.
        assert point["seed_error_trimmed"] == pytest.approx((0.1 * d) ** 2 / DENOMINATOR, rel=1e-3)
    head, *rows = read.table("room: medians")
    row = next(row for row in rows if row[:2] == ["VMM", "4s"])
    assert row[head.index("render s")] == "4" and row[head.index("spp")] == "40"
    assert row[head.index(RELMSE)] == "0.00248 (0.002 to 0.003)"  # 0.0025 / 1.01
    assert row[head.index(MAPE)] == "0.0495 (0.0446 to 0.0545)"  # 0.05 / 1.01
    assert row[head.index("learned until [spp]")] == "20"


def test_rays_are_told_by_bare_embrees_time(page: tuple[Page, Path]) -> None:
    head, *rows = page[0].table("room: medians")
    told = {(row[0], row[1]): row[head.index("rays alone [s]")] for row in rows}
    # 3 million rays; two threads of 3 million a second each.
    assert told["OFF", "1s"] == told["OFF", "4s"] == "0.5"
    assert told["cycles", "1s"] == told["VMM", "1s"] == "-"
    assert "by bare Embree" in page[0].text


def test_front_is_what_nothing_beats(page: tuple[Page, Path]) -> None:
    head, *rows = page[0].table("room: medians")
    on_front = {(row[0], row[1]) for row in rows if row[head.index("on the front")] == "yes"}
    # OFF and VMM are equally good after one second: one of them is enough.
    assert ("VMM", "4s") in on_front and len(on_front) == 2
    assert len({("OFF", "1s"), ("VMM", "1s")} & on_front) == 1


def test_efficiencies_are_ratios_to_cycles_and_to_the_better_of_both(page: tuple[Page, Path]) -> None:
    # After 4 s errors are 0.2^2, 0.1^2, 0.1^2, 0.05^2 by 1.01, times alike.
    for base, expected in (
        ("cycles", {"cycles": 1, "cycles-guided": 4, BETTER_CYCLES: 4, "OFF": 4, "VMM": 16}),
        (BETTER_CYCLES, {"cycles": 0.25, "cycles-guided": 1, BETTER_CYCLES: 1, "OFF": 1, "VMM": 4}),
    ):
        head, *rows = page[0].table(f"Efficiency, {base} = 1, against references")
        assert head == ["rival", "geometric mean", "room"]
        assert {row[0]: (float(row[1]), float(row[2])) for row in rows} == {
            rival: (value, value) for rival, value in expected.items()
        }


def test_better_of_cycles_is_picked_scene_by_scene() -> None:
    def point(rival: str, error: float, seconds: float = 2.0) -> figures.Point:
        made = figures.Point(rival, figures.Budget(4), 3, seconds, 4.0, 1.0)
        made.errors[RELMSE_TRIMMED] = figures.Spread(error, error, error)
        return made

    finals = {
        "a": [point("cycles", 1.0), point("cycles-guided", 0.5), point("VMM", 0.25)],
        "b": [point("cycles", 1.0), point("cycles-guided", 2.0), point("VMM", 0.5, 1.0)],
    }
    ratios = figures.efficiency_ratios(finals)
    assert ratios is not None and ratios.base == "cycles"
    assert ratios.values[BETTER_CYCLES] == {"a": 2.0, "b": 1.0}
    assert ratios.values["VMM"] == {"a": 4.0, "b": 4.0}
    assert ratios.mean("cycles-guided") == pytest.approx(1.0)
    over_better = figures.efficiency_ratios(finals, BETTER_CYCLES)
    assert over_better is not None and over_better.values["VMM"] == {"a": 2.0, "b": 4.0}
    assert over_better.mean("VMM") == pytest.approx(math.sqrt(8.0))
    assert figures.efficiency_ratios({"a": [point("OFF", 1.0)]}) is None
    # Who has no figure in a scene has no mean that could be compared.
    lacking = figures.efficiency_ratios({"a": finals["a"], "b": finals["b"][:2]})
    assert lacking is not None and lacking.values["VMM"] == {"a": 4.0} and math.isnan(lacking.mean("VMM"))


def test_end_of_training_is_found_between_budgets() -> None:
    def line(end: float | None) -> list[figures.Point]:
        return [
            figures.Point("VMM", figures.Budget(1, seconds), 3, seconds, 10.0 * seconds, 1.0, training_end=end)
            for seconds in (1.0, 4.0)
        ]

    # 10 samples after 1 s, 40 after 4 s, 20 in between: straight in logarithms, after 2 s.
    assert figures.learning_end(line(20.0)) == pytest.approx((20.0, 2.0))
    assert figures.learning_end(line(5.0)) == pytest.approx((5.0, 0.5))
    assert figures.learning_end(line(None)) is None and figures.learning_end([]) is None
    assert figures.interpolate(2.0, [1.0, 4.0], [0.4, 0.1]) == pytest.approx(0.2)


def test_time_is_told_by_kind_of_work(page: tuple[Page, Path]) -> None:
    head, *rows = page[0].table("room, 4s: seconds of all threads")
    told = {row[0]: dict(zip(head[1:], row[1:], strict=True)) for row in rows}
    # Two threads for 4 s; 2 + 3 + 0.25 + 1 + 0.5 are accounted for.
    expected = {"tracing": 2, "shading": 3, "inference": 0.25, "fitting": 1, "training": 0.5, "waiting": 1.25}
    assert {kind: float(told["VMM"][kind]) for kind in expected} == expected
    assert told["cycles"]["rendering"] == "8" and told["cycles"]["tracing"] == "-"


def test_a_reference_too_noisy_for_what_is_measured_is_told(page: tuple[Page, Path]) -> None:
    warning = next(text for text in page[0].text.split("Warning: ")[1:] if "own error" in text)
    # 0.001 is 40% of 0.0025 / 1.01, 10.1% of 0.01 / 1.01, and less than a tenth of all others.
    named = warning.split(" measured for ")[1].split(". Those")[0].split(", ")
    assert set(named) == {"OFF after 4s (10%)", "VMM after 4s (40%)", "cycles-guided after 4s (10%)"}


def test_the_page_is_complete_and_needs_no_network(page: tuple[Page, Path]) -> None:
    read, path = page
    html = path.read_text(encoding="utf-8")
    assert not re.search(r"https?:|//[a-z]", re.sub(r"(?m)^\s*//.*$", "", html))
    missing = [file for file in read.files if not (path.parent / file).is_file()]
    assert not missing and len(read.files) > 30
    assert all(image.get("alt") for image in read.images)
    assert set(re.findall(r'href="#([^"]+)"', html)) <= set(re.findall(r'id="([^"]+)"', html))
    environment = describe()
    assert escape(environment["cpu"]) in html and environment["commit"] in html
    assert f"bpy {environment['versions']['bpy']}" in html


def test_without_a_reference_errors_are_variances_over_seeds(tmp_path: Path) -> None:
    write_line(tmp_path / "sweep", "cycles", {1.0: 0.4, 4.0: 0.2}, around)
    write_line(tmp_path / "sweep", "OFF", {1.0: 0.2, 4.0: 0.1}, around)
    scenes, _ = collect(tmp_path / "sweep")
    points = {(p.rival, p.budget.seconds): p for p in figures.measure_scene(scenes[0])}
    for (rival, seconds), d in {("cycles", 1.0): 0.4, ("OFF", 1.0): 0.2, ("OFF", 4.0): 0.1}.items():
        point = points[rival, seconds]
        assert set(point.errors) == {RELMSE, RELMSE_TRIMMED}
        # Seeds are off by (-d, 0, d): each adds (d^2, 0, d^2) times 3 / 2, and their mean is the variance d^2.
        assert point.errors[RELMSE].centre == pytest.approx(d**2 / DENOMINATOR, rel=1e-4)
        assert point.errors[RELMSE].low == pytest.approx(0.0, abs=1e-9)
        assert point.errors[RELMSE].high == pytest.approx(1.5 * d**2 / DENOMINATOR, rel=1e-4)
    read = Page(write_report(tmp_path / "sweep", tmp_path / "page"))
    assert "no reference" in read.text
    rows = {row[0]: row[1] for row in read.table("Efficiency, cycles = 1")[1:]}
    assert rows == {"cycles": "1", "OFF": "4"}


def test_foreign_references_are_refused_on_the_page(tmp_path: Path) -> None:
    write_render(tmp_path / "sweep", "OFF", 1, grey(), samples=4)
    for facts, reason in (
        ({"scene_hash": "other"}, "another version of the scene (other, this one is hash)"),
        ({"light_paths": {"max_bounces": 3, "clamp_direct": 0.0}}, "max_bounces 3 instead of 8"),
    ):
        write_reference(tmp_path / "references", grey(), **facts)
        scenes, _ = collect(tmp_path / "sweep", tmp_path / "references")
        assert scenes[0].reference is None
        assert any("reference refused" in text and reason in text for text in scenes[0].remarks)
    write_reference(tmp_path / "references", grey()[: HEIGHT // 2])
    scenes, _ = collect(tmp_path / "sweep", tmp_path / "references")
    assert any(f"{WIDTH} x {HEIGHT // 2} pixels" in text for text in scenes[0].remarks)
    read = Page(write_report(tmp_path / "sweep", tmp_path / "page", tmp_path / "references"))
    assert "reference refused" in read.text and "no error is known" in read.text


def test_what_cannot_be_compared_is_kept_apart(tmp_path: Path) -> None:
    write_render(tmp_path, "OFF", 1, grey(), samples=4)
    write_render(tmp_path, "OFF", 1, grey(), samples=8, settings={"use_nee": False})
    write_render(tmp_path, "NASG-SG", 1, grey(), samples=4, settings={"guiding_method": "NASG", "mixture_lobes": "SG"})
    other = tmp_path / "4spp" / "room" / "OFF_4spp_seed1.json"
    (other.with_name("torn.json")).write_text("{", encoding="utf-8")
    other.with_name("torn.exr").write_bytes(b"")
    (tmp_path / "summary.json").write_text("{}", encoding="utf-8")
    scenes, remarks = collect(tmp_path)
    assert [scene.rivals for scene in scenes] == [["OFF", "NASG-SG", "OFF use_nee=False"]]
    assert len(remarks) == 1 and "torn.json is left out" in remarks[0]
    record = json.loads(other.read_text(encoding="utf-8"))
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "a.json").write_text(json.dumps({**record, "scene_hash": "new"}), encoding="utf-8")
    (tmp_path / "other" / "a.exr").write_bytes(other.with_suffix(".exr").read_bytes())
    assert [scene.scene_hash for scene in collect(tmp_path)[0]] == ["hash", "new"]
    with pytest.raises(ValueError, match="no renders"):
        collect(tmp_path / "nowhere")


def test_what_was_chosen_is_on_the_front(tmp_path: Path) -> None:
    details = {"learning": {"chosen": "TABLE_RIS"}}
    write_line(tmp_path / "sweep", "AUTO", {1.0: 0.2, 4.0: 0.1}, around, details=details)
    read = Page(write_report(tmp_path / "sweep", tmp_path / "page"))
    head, *rows = read.table("room: medians")
    assert [row[head.index("chose")] for row in rows] == ["TABLE_RIS", "TABLE_RIS"]


def test_the_crop_is_where_rivals_differ_most() -> None:
    quiet, loud = np.full((40, 80), 1e-3), np.full((40, 80), 1e-3)
    loud[22:32, 50:70] = 1.0
    # Noise that both have, and a single pixel, do not count.
    quiet[:10, :20] = loud[:10, :20] = 5.0
    loud[5, 75] = 1e6
    crop = choose_crop([quiet, loud])
    assert (crop.width, crop.height) == (20, 16)
    assert crop.x == 50 and crop.y <= 22 and crop.y + crop.height >= 32
    assert Crop(1, 2, 3, 4).cut(np.arange(100).reshape(10, 10))[0, 0] == 21
    tiny = choose_crop([np.ones((3, 5))])
    assert (tiny.x, tiny.y, tiny.width, tiny.height) == (0, 0, 5, 3)


def test_false_colours_grow_with_error_and_survive_what_is_not_finite() -> None:
    limits = colour_range([np.geomspace(1e-3, 10.0, 1000).reshape(20, 50)])
    assert limits == pytest.approx((1e-3, 10.0))
    colours = false_colour(np.array([[0.0, 1e-3, 1e-1, 10.0, np.inf, np.nan]]), limits)[0].astype(int).sum(axis=-1)
    assert colours[0] == colours[1] < colours[2] < colours[3] == colours[4] == colours[5]
    assert colour_range([np.zeros((4, 4))]) == (1e-4, 1.0)


def test_rivals_look_different_from_each_other_and_the_same_everywhere() -> None:
    assert len({(one.colour, one.marker, one.line) for one in LOOKS.values()}) == len(LOOKS)
    assert len({one.marker for one in LOOKS.values()}) == len(LOOKS)
    assert all(one.marker in GLYPHS for one in LOOKS.values())
    assert look("OFF use_nee=False") == look("OFF use_nee=False") and look("unheard of").marker in GLYPHS
    assert file_name("OFF use_nee=False/..") == "OFF-use_nee-False-.."


def test_scaling_is_drawn_where_it_was_measured(tmp_path: Path) -> None:
    assert scaling_section(tmp_path, tmp_path) == ""
    curve = Curve("resolution", "OFF", "pixels", "seconds per sample", [1.0, 2.0, 4.0], [3.0, 6.0, 12.0])
    stored = {"environment": {"cpu": "a processor", "commit": "abc"}, "curves": [curve.stored()]}
    (tmp_path / SCALING_FILE).write_text(json.dumps(stored), encoding="utf-8")
    section = scaling_section(tmp_path, tmp_path)
    assert "1.00 ± 0.00" in section and "a processor, commit abc" in section
    assert (tmp_path / "scaling.png").is_file() and (tmp_path / "scaling-dark.png").is_file()


def test_a_report_of_nothing_is_explained(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["report", str(tmp_path), "--to", str(tmp_path / "page")]) == 2
    assert "no renders in" in capsys.readouterr().err
