# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks scale`: time and memory of scenes as large as they come, beside Cycles.

Each render has a process of its own, and rivals take turns. Where the frame is not what is large, it is small, so that
what counts is what a scene needs before its first sample.
"""

from __future__ import annotations

import datetime
import json
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks import environment
from benchmarks.tables import table

SCALE_FILE = "scale.json"
#: What ours may need: so many times the memory of Cycles, and so much more [MiB].
MEMORY_FACTOR, MEMORY_SLACK = 1.2, 300.0


@dataclass(frozen=True)
class ScaleCase:
    """What is large, and how large.

    unit : what is counted
    count : how many there are at full size; of frames, the pixels in a row
    build : callable (count, folder for files), which fills the open file
    size : of the picture; None: it is what is large, with `count` pixels in a row
    with_passes : whether it has the passes that take the most room
    """

    name: str
    unit: str
    count: int
    build: Callable[[int, Path], None]
    samples: int = 4
    size: tuple[int, int] | None = (320, 240)
    with_passes: bool = False

    def frame(self, count: int) -> tuple[int, int]:
        """Width and height of the picture."""
        return (count, max(9 * count // 16, 1)) if self.size is None else self.size


def _terrain(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.terrain(count)


def _instances(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.instances(count)


def _stage(_count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.stage()


def _textures(count: int, folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.textures(count, folder)


def _light_objects(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.light_objects(count)


def _emitters(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.lamps(count)


def _strands(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.strands(count)


def _hair(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.hair(count)


def _points(count: int, _folder: Path) -> None:
    from benchmarks.scenes import growing

    growing.points(count)


CASES = {
    case.name: case
    for case in (
        ScaleCase("triangles", "triangles", 10_000_000, _terrain),
        ScaleCase("instances", "instances", 100_000, _instances),
        # Both renderers go through all lamps for each ray: so the picture is very small.
        ScaleCase("lights", "light objects", 100_000, _light_objects, 1, (48, 36)),
        ScaleCase("emitters", "emitting triangles", 100_000, _emitters),
        ScaleCase("strands", "strands", 1_000_000, _strands),
        ScaleCase("hair", "hairs of particles", 1_000_000, _hair),
        ScaleCase("points", "points", 1_000_000, _points),
        ScaleCase("textures", "images of 4096 x 4096", 1000, _textures),
        ScaleCase("4k", "pixels in a row", 3840, _stage, 1, None),
        ScaleCase("8k", "pixels in a row", 7680, _stage, 1, None),
        ScaleCase("8k-passes", "pixels in a row", 7680, _stage, 1, None, with_passes=True),
    )
}


@dataclass
class ScaleRecord:
    """One render's figures.

    scene_mib : memory with the scene open, before the render
    peak_mib : the largest during it, all of the process
    message : why there is none, '' if there is
    """

    case: str
    count: int
    rival: str
    scene_mib: float = float("nan")
    peak_mib: float = float("nan")
    wall_seconds: float = float("nan")
    export_seconds: float = float("nan")
    render_seconds: float = float("nan")
    message: str = ""

    @property
    def added_mib(self) -> float:
        """What the render needs beside the open scene."""
        return self.peak_mib - self.scene_mib


def is_within_memory(ours: ScaleRecord, cycles: ScaleRecord) -> bool:
    """Whether ours keeps to the target, of the memory of the whole process."""
    return ours.peak_mib <= MEMORY_FACTOR * cycles.peak_mib + MEMORY_SLACK


def render_case(case: ScaleCase, count: int, rival: str, folder: Path, threads: int, timeout: float) -> ScaleRecord:
    """Build and render in a process of its own; what goes wrong there is the record's message."""
    record = ScaleRecord(case.name, count, rival)
    out = folder / f"{case.name}-{count}-{rival}.json"
    out.unlink(missing_ok=True)
    task = json.dumps({"record": asdict(record), "folder": str(folder), "threads": threads})
    command = [sys.executable, "-m", "benchmarks.scale_process", task, str(out)]
    try:
        finished = subprocess.run(command, capture_output=True, text=True, check=False, timeout=timeout)
    except subprocess.TimeoutExpired:
        record.message = f"not done after {timeout:g} s"
        return record
    if finished.returncode == 0 and out.exists():
        return ScaleRecord(**json.loads(out.read_text(encoding="utf-8")))
    lines = finished.stderr.strip().splitlines()
    record.message = lines[-1] if lines and finished.returncode > 0 else f"ended by signal {-finished.returncode}"
    return record


def scale_table(records: Sequence[ScaleRecord]) -> str:
    """A line a case: seconds and memory of both, and whether ours keeps to the target."""
    rows: list[list[float | int | str | None]] = []
    by_key = {(record.case, record.count, record.rival): record for record in records}
    for name, count in dict.fromkeys((record.case, record.count) for record in records):
        ours = by_key.get((name, count, "OFF"), ScaleRecord(name, count, "OFF"))
        cycles = by_key.get((name, count, "cycles"), ScaleRecord(name, count, "cycles"))
        verdict = ours.message or cycles.message or ("yes" if is_within_memory(ours, cycles) else "no")
        rows.append(
            [
                name, f"{count:,} {CASES[name].unit}", round(ours.scene_mib, 0), ours.wall_seconds,
                cycles.wall_seconds, round(ours.peak_mib, 0), round(cycles.peak_mib, 0), verdict,
            ]
        )  # fmt: skip
    header = ["case", "size", "open scene [MiB]", "ours [s]", "Cycles [s]", "ours [MiB]", "Cycles [MiB]", "in target"]
    return table(header, rows)


def scale(
    *, out: Path, share: float = 1.0, only: Sequence[str] = (), rivals: Sequence[str] = ("OFF", "cycles"),
    threads: int = 0, timeout: float = 1800.0,
) -> list[ScaleRecord]:
    """Measure, print, write `out/scale.json`.

    Parameters
    ----------
    share : of the full counts, above 0
    only : names out of CASES; none: all
    timeout : of each render [s]
    """
    out.mkdir(parents=True, exist_ok=True)
    records: list[ScaleRecord] = []
    for name in only or CASES:
        case = CASES[name]
        count = max(round(case.count * share), 1)
        for rival in rivals:
            record = render_case(case, count, rival, out.resolve(), threads or environment.thread_count(), timeout)
            records.append(record)
            what = record.message or f"{record.wall_seconds:.1f} s, {record.peak_mib:.0f} MiB"
            print(f"  {name} {count:,} {rival}: {what}", flush=True)
    facts = environment.describe()
    print(f"\ncommit {facts['commit']}, {facts['cpu']}\n\n{scale_table(records)}")
    stored = {
        "environment": facts,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "records": [asdict(record) for record in records],
    }
    (out / SCALE_FILE).write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    return records
