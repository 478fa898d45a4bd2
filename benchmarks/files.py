# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks files`: do other people's files look as in Cycles?

Each file is opened and rendered by both in a process of its own, small, once without clamps and once as its settings
are. It agrees where `benchmarks.parity.compare` finds no difference of means or cells in either.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment
from benchmarks.files_process import RIVALS, SETTINGS
from benchmarks.gallery import stack, strip
from benchmarks.images import Float32Array, read_exr
from benchmarks.parity import ParityResult, compare
from benchmarks.tables import table


@dataclass
class FileResult:
    """The comparison of one file.

    added : what the file lacked and was given, of 'camera' and 'light'
    notices : what our render said
    results : a comparison for each of SETTINGS; empty where the file failed
    failure : why there is none, '' if there is
    """

    file: str
    seconds: float = 0.0
    version: list[int] = field(default_factory=list)
    added: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    results: dict[str, ParityResult] = field(default_factory=dict)
    failure: str = ""

    @property
    def agrees(self) -> bool:
        """Whether no comparison found a difference."""
        return not self.failure and not any(r.verdict.startswith("differs") for r in self.results.values())

    @property
    def finding(self) -> str:
        """What was found, in a few words."""
        if self.failure:
            return f"failed: {self.failure}"
        found = [f"{name}: {r.verdict}" for name, r in self.results.items() if r.verdict.startswith("differs")]
        return "; ".join(found) or ("agrees, noisy" if self.is_noisy else "agrees")

    @property
    def is_noisy(self) -> bool:
        """Whether standard errors are too large to tell."""
        return any(r.is_noisy for r in self.results.values())


def add_arguments(commands: Any) -> None:
    """Add the command to the subparsers of an `argparse.ArgumentParser`."""
    text = "do other people's files look as in Cycles?"
    command = commands.add_parser("files", help=text, description=text)
    command.add_argument("files", nargs="+", type=Path, help=".blend files, or folders that are searched for them")
    command.add_argument("--width", type=int, default=96, help="pixels of the longer side (default: %(default)s)")
    command.add_argument("--samples", type=int, default=16, help="per pixel and seed (default: %(default)s)")
    command.add_argument("--seeds", type=int, default=3, help="renders of each kind (default: %(default)s)")
    command.add_argument(
        "--most-seeds", type=int, default=0, help="while too noisy to tell, double the seeds up to so many"
    )
    command.add_argument("--limit", type=float, default=240.0, help="seconds a file and call (default: %(default)s)")
    command.add_argument("--threads", type=int, default=0, help="0 = all cores")
    command.add_argument(
        "--out", type=Path, default=Path("out/files"), help="folder for results (default: %(default)s)"
    )
    command.add_argument("--resume", action="store_true", help="keep files that an earlier run compared")


def find_files(paths: Sequence[Path]) -> list[Path]:
    """The .blend files of the command line, those of folders within folders too.

    Raises
    ------
    ValueError
        Naming what does not exist.
    """
    found: list[Path] = []
    for path in paths:
        if path.is_dir():
            found += sorted(path.rglob("*.blend"))
        elif path.is_file():
            found.append(path)
        else:
            raise ValueError(f"no file {path}: give a .blend file or a folder")
    return list(dict.fromkeys(file.resolve() for file in found))


def _render(file: Path, folder: Path, chosen: argparse.Namespace, first_seed: int, seeds: int) -> str:
    """Render seeds of a file by both; returns what went wrong, '' if nothing did."""
    task = {
        "file": str(file), "folder": str(folder), "width": chosen.width, "samples": chosen.samples,
        "first_seed": first_seed, "seeds": seeds, "threads": chosen.threads or environment.thread_count(),
    }  # fmt: skip
    command = [sys.executable, "-m", "benchmarks.files_process", json.dumps(task)]
    log = folder / "log.txt"
    with log.open("w", encoding="utf-8") as output:
        try:
            status = subprocess.run(
                command, stdout=output, stderr=subprocess.STDOUT, check=False, timeout=chosen.limit
            ).returncode
        except subprocess.TimeoutExpired:
            return f"not done after {chosen.limit:g} s"
    if status:
        lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
        return lines[-1] if status > 0 and lines else f"exit status {status}"
    return ""


def _pictures(folder: Path, settings: str, name: str, seeds: int) -> list[Float32Array]:
    return [read_exr(folder / f"{settings}_{name}_{seed}.exr")[0] for seed in range(1, seeds + 1)]


def _save_pair(result: FileResult, folder: Path, seeds: int, to: Path) -> None:
    strips = []
    for settings in SETTINGS:
        theirs, ours = (np.mean(_pictures(folder, settings, name, seeds), axis=0) for name in RIVALS)
        title = f"{folder.name} {settings}: NeuralGuide, Cycles, difference (red: brighter)"
        strips.append(strip(title, ours, theirs, 288))
    stack(strips, 1).save(to)


def compare_file(file: Path, chosen: argparse.Namespace) -> FileResult:
    """Render a file by both and compare the pictures; writes `NAME.png` and `NAME/result.json`."""
    name = f"{file.stem}-{hashlib.sha256(str(file).encode()).hexdigest()[:6]}"
    folder = chosen.out / name
    kept = folder / "result.json"
    if chosen.resume and kept.is_file():
        stored = json.loads(kept.read_text(encoding="utf-8"))
        stored["results"] = {key: ParityResult(**value) for key, value in stored["results"].items()}
        return FileResult(**stored)
    folder.mkdir(parents=True, exist_ok=True)
    result, start, done = FileResult(str(file)), time.monotonic(), 0
    while True:
        wanted = 2 * done or chosen.seeds
        result.failure = _render(file, folder, chosen, done + 1, wanted - done)
        if result.failure:
            break
        done = wanted
        for settings in SETTINGS:
            theirs, ours = (_pictures(folder, settings, rival, done) for rival in RIVALS)
            result.results[settings] = compare(file.stem, ours, theirs, chosen.samples, error_ratio_limit=math.inf)
        if not result.is_noisy or 2 * done > chosen.most_seeds:
            break
    if done:
        facts = json.loads((folder / "file.json").read_text(encoding="utf-8"))
        result.added, result.notices, result.version = facts["added"], facts["notices"], facts["version"]
        _save_pair(result, folder, done, chosen.out / f"{name}.png")
    result.seconds = time.monotonic() - start
    kept.write_text(json.dumps(asdict(result), indent=1) + "\n", encoding="utf-8")
    return result


def files_table(results: Sequence[FileResult]) -> str:
    """The comparisons as a table; differences and standard errors are those of the renders without clamps."""
    rows: list[list[float | str | None]] = []
    for result in results:
        plain = result.results.get(SETTINGS[0])
        rows.append([
            Path(result.file).name,
            ", ".join(result.added),
            f"{100 * plain.mean_difference:+.2f} ± {100 * plain.mean_error:.2f}" if plain else "-",
            100 * plain.cell_worst if plain else None,
            len(result.notices),
            result.finding,
        ])  # fmt: skip
    return table(["file", "added", "mean %", "cell %", "said", "finding"], rows)


def files(chosen: argparse.Namespace) -> int:
    """Compare every file, print the table, write it and JSON; returns how many differ or failed.

    Raises
    ------
    ValueError
        For fewer than 2 seeds, or a path that does not exist.
    """
    if chosen.seeds < 2:
        raise ValueError("files needs at least 2 seeds, for standard errors")
    results = []
    for file in find_files(chosen.files):
        results.append(compare_file(file, chosen))
        print(f"  {file.name}: {results[-1].finding}", flush=True)
        for notice in results[-1].notices:
            print(f"    says: {notice}", flush=True)
    agreeing = [result for result in results if result.agrees]
    silent = [result for result in agreeing if not result.notices]
    text = files_table(results)
    print(f"\n{text}\n\n{len(agreeing)} of {len(results)} agree, {len(silent)} of them with nothing said")
    chosen.out.mkdir(parents=True, exist_ok=True)
    (chosen.out / "files.md").write_text(text + "\n", encoding="utf-8")
    summary = {"environment": environment.describe(), "results": [asdict(result) for result in results]}
    (chosen.out / "files.json").write_text(json.dumps(summary, indent=1) + "\n", encoding="utf-8")
    return len(results) - len(agreeing)
