# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that end in charts or tables of growth: `sweep`, `reference`, `report`, `scaling`, `scale`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from benchmarks.scene_files import BUILTIN, expand

CHART_COMMANDS = ("sweep", "reference", "report", "scaling", "scale")
#: Without an interest in a certain method: Cycles both ways, ours unguided, and the mixture field.
RIVALS = ["cycles", "cycles-guided", "OFF", "VMM"]


def add_chart_commands(commands: Any) -> None:
    """Add them to the subparsers of an `argparse.ArgumentParser`."""

    def add(name: str, text: str) -> argparse.ArgumentParser:
        found: argparse.ArgumentParser = commands.add_parser(name, help=text, description=text)
        return found

    def add_scenes(command: argparse.ArgumentParser, seeds: int) -> None:
        command.add_argument(
            "scenes", nargs="*", help=f".blend files, folders of them, or {BUILTIN}NAME (patterns allowed)"
        )
        command.add_argument("--seeds", type=int, default=seeds, help="renders of each kind (default: %(default)s)")
        command.add_argument("--pixels", type=int, default=0, help="scale scenes to about so many pixels")
        command.add_argument("--threads", type=int, default=0, help="0 = all cores")

    sweep = add("sweep", "rivals under budgets that grow in steps; finished renders are kept")
    add_scenes(sweep, 3)
    sweep.add_argument("--rivals", nargs="+", default=RIVALS, help="cycles, cycles-guided, OFF, ...")
    sweep.add_argument("--samples", type=int, nargs="+", default=[4, 16, 64], help="per pixel (default: %(default)s)")
    sweep.add_argument("--seconds", type=float, nargs="+", default=[], help="stop by time instead of samples")
    sweep.add_argument("--references", type=Path, help="folder that `reference` wrote; they set the size too")
    sweep.add_argument("--anew", action="store_true", help="render again what is there")
    own = sweep.add_mutually_exclusive_group()
    own.add_argument("--isolate", action="store_true", help="a process for every render: honest memory figures")
    own.add_argument(
        "--at-defaults", action="store_true", help="with Blender's clamps, Filter Glossy and Light Threshold"
    )
    sweep.add_argument("--out", type=Path, default=Path("out/sweep"), help="folder for results (default: %(default)s)")

    reference = add("reference", "pictures to compare with, the mean of seeds; further calls add seeds")
    add_scenes(reference, 4)
    reference.add_argument("--samples", type=int, default=256, help="per pixel and seed (default: %(default)s)")
    reference.add_argument("--rival", default="cycles", help="who renders them (default: %(default)s)")
    reference.add_argument("--out", type=Path, default=Path("out/references"), help="folder (default: %(default)s)")

    report = add("report", "a page of charts out of what `sweep` or `run` left; renders nothing")
    report.add_argument("folder", type=Path, nargs="?", default=Path("out/sweep"), help="default: %(default)s")
    report.add_argument("--references", type=Path, help="folder that `reference` wrote")
    report.add_argument("--to", type=Path, default=Path("out/report"), help="for the page (default: %(default)s)")

    scaling = add("scaling", "how cost grows with resolution, triangles, lights, threads, depth, candidates, networks")
    scaling.add_argument("--quick", action="store_true", help="fewer and shorter steps: under three minutes")
    scaling.add_argument("--only", nargs="+", default=[], help="some of: resolution triangles lights threads ...")
    scaling.add_argument("--threads", type=int, default=0, help="0 = all cores")
    scaling.add_argument("--out", type=Path, default=Path("out/sweep"), help="folder (default: %(default)s)")

    scale = add("scale", "time and memory of very large scenes and frames, a process a render, beside Cycles")
    scale.add_argument("--share", type=float, default=1.0, help="of the full sizes (default: all)")
    scale.add_argument("--only", nargs="+", default=[], help="some of: triangles instances lights textures 4k 8k ...")
    scale.add_argument("--rivals", nargs="+", default=["OFF", "cycles"], help="in turns (default: ours and Cycles)")
    scale.add_argument("--threads", type=int, default=0, help="0 = all cores")
    scale.add_argument("--out", type=Path, default=Path("out/scale"), help="folder (default: %(default)s)")


def run_chart_command(chosen: argparse.Namespace, default_scenes: Sequence[str]) -> int:
    """Run one of CHART_COMMANDS; returns the exit status."""
    try:
        return _run(chosen, default_scenes)
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


def _run(chosen: argparse.Namespace, default_scenes: Sequence[str]) -> int:
    if chosen.command == "report":
        from benchmarks.report.page import write_report

        print(f"wrote {write_report(chosen.folder, chosen.to, chosen.references)}")
        return 0
    if chosen.command == "scaling":
        from benchmarks.scaling import CURVES, scaling

        unknown = [name for name in chosen.only if name not in CURVES]
        if unknown:
            raise ValueError(f"no scaling with {', '.join(unknown)}; there are: {', '.join(CURVES)}")
        scaling(out=chosen.out, threads=chosen.threads, is_quick=chosen.quick, only=chosen.only)
        return 0
    if chosen.command == "scale":
        from benchmarks.scale import CASES, scale

        unknown = [name for name in chosen.only if name not in CASES]
        if unknown:
            raise ValueError(f"no scale of {', '.join(unknown)}; there are: {', '.join(CASES)}")
        if chosen.share <= 0.0:
            raise ValueError(f"a share of {chosen.share:g}: give more than 0, 1 is all")
        records = scale(
            out=chosen.out, share=chosen.share, only=chosen.only, rivals=chosen.rivals, threads=chosen.threads
        )
        return 1 if any(record.message for record in records) else 0
    from benchmarks.rivals import find_rival

    sources = expand(chosen.scenes or [BUILTIN + name for name in default_scenes])
    size = {"pixels": chosen.pixels, "threads": chosen.threads}
    if chosen.command == "reference":
        from benchmarks.reference import make_references

        rival = find_rival(chosen.rival)
        return 1 if make_references(sources, rival, chosen.samples, chosen.seeds, out=chosen.out, **size) else 0
    from benchmarks.sweep import budgets, sweep

    failures = sweep(
        sources, [find_rival(name) for name in chosen.rivals], budgets(chosen.samples, chosen.seconds), chosen.seeds,
        out=chosen.out, references=chosen.references, resume=not chosen.anew, isolate=chosen.isolate,
        at_defaults=chosen.at_defaults, **size,
    )  # fmt: skip
    return 1 if failures else 0
