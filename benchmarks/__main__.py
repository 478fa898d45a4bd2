# SPDX-License-Identifier: GPL-3.0-or-later
"""Command line of the benchmarks: `python -m benchmarks run|sweep|reference|report|scaling|papers|stability|...`."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.chart_commands import CHART_COMMANDS, add_chart_commands, run_chart_command
from benchmarks.farm import add_arguments as add_farm_arguments
from benchmarks.files import add_arguments as add_file_arguments
from benchmarks.files import files
from benchmarks.fingerprints import add_arguments as add_fingerprint_arguments
from benchmarks.fingerprints import fingerprints
from benchmarks.papers import PROTOCOLS
from benchmarks.scene_files import BUILTIN, SceneSource, expand
from benchmarks.stability import add_arguments as add_stability_arguments
from benchmarks.viewport import add_arguments as add_viewport_arguments
from benchmarks.viewport_race import add_arguments as add_race_arguments
from engine.settings import SAMPLE_WEIGHTINGS

#: What runs where no scene is named.
SHORT_SET = ["diffuse", "glass-rough", "principled-everything", "many-lights", "world-image-sun", "evening-room"]


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="python -m benchmarks", description="Compare NEURALGUIDE with Cycles.")
    commands = parser.add_subparsers(dest="command", required=True)

    def add(
        name: str, text: str, samples: int, seeds: int, out: str, first: Sequence[str] = ()
    ) -> argparse.ArgumentParser:
        command = commands.add_parser(name, help=text, description=text)
        if first:
            command.add_argument(first[0], choices=first[1:])
        command.add_argument(
            "scenes", nargs="*", help=f".blend files, folders of them, or {BUILTIN}NAME (patterns allowed)"
        )
        command.add_argument("--samples", type=int, default=samples, help="per pixel (default: %(default)s)")
        command.add_argument("--seeds", type=int, default=seeds, help="renders per rival (default: %(default)s)")
        command.add_argument("--pixels", type=int, default=0, help="scale scenes to about so many pixels")
        command.add_argument("--threads", type=int, default=0, help="0 = all cores")
        command.add_argument("--out", type=Path, default=Path(out), help="folder for results (default: %(default)s)")
        command.add_argument("--resume", action="store_true", help="keep renders that an earlier run finished")
        return command

    run = add("run", "speed and error of every rival", 64, 3, "out/benchmarks")
    run.add_argument("--rivals", nargs="+", default=["cycles", "OFF"], help="cycles, cycles-guided, OFF, ...")
    run.add_argument("--seconds", type=float, default=0.0, help="stop by time instead of samples")
    run.add_argument(
        "--noise-threshold", type=float, default=0.0, help="stop sampling pixels whose noise is below (0 = none)"
    )
    run.add_argument("--first-seed", type=int, default=1, help="renders of the same seed are not independent")
    run.add_argument(
        "--no-nee", action="store_true", help="without light sampling (ours only); results go into OUT/no-nee"
    )
    own = run.add_mutually_exclusive_group()
    own.add_argument(
        "--isolate", action="store_true", help="a process for every render: honest memory and first-image figures"
    )
    own.add_argument("--at-defaults", action="store_true", help="by Blender's clamps; results go into OUT/at-defaults")
    run.add_argument("--references", type=Path, help="folder of NAME.exr to compare with; they set the size too")
    add_chart_commands(commands)
    papers = add(
        "papers", "methods of guiding by a paper's own protocol; finished renders are kept", 0, 3, "out/papers",
        ("paper", *PROTOCOLS),
    )  # fmt: skip
    papers.add_argument("--methods", nargs="+", help="instead of the paper's, e.g. OFF SDTREE VMM NPM NASG-SG")
    papers.add_argument(
        "--sample-weighting", choices=SAMPLE_WEIGHTINGS, default=SAMPLE_WEIGHTINGS[0],
        help="how samples from before much was learned count (default: %(default)s)",
    )  # fmt: skip
    papers.add_argument("--references", type=Path, help="folder of NAME.exr to take percentage errors against")
    parity = add("parity", "is it Cycles' picture?", 256, 4, "out/parity")
    parity.add_argument("--rival", default="OFF", help="which of our methods (default: %(default)s)")
    parity.add_argument(
        "--most-seeds", type=int, default=0, help="while too noisy to tell, double the seeds up to so many"
    )
    parity.add_argument(
        "--without-lamps", action="store_true", help="hide lamps from the camera: their edges are most of the noise"
    )
    add("first-click", "is it Cycles' picture by the command line, with nothing set but the engine?", 128, 4,
        "out/first-click")  # fmt: skip
    profile = add("profile", "time and rays per stage, and how near to bare Embree", 32, 1, "out/profile")
    profile.add_argument("--no-replay", action="store_true", help="skip tracing the recorded rays again")
    gallery = add("gallery", "contact sheets: ours, Cycles', difference", 128, 1, "docs/gallery")
    gallery.add_argument("--rival", default="OFF", help="which of our methods (default: %(default)s)")
    sheets = add("passes", "contact sheets of a scene's passes: ours, Cycles', difference", 128, 1, "docs/gallery")
    sheets.add_argument("--rival", default="OFF", help="which of our methods (default: %(default)s)")
    add_stability_arguments(commands.add_parser("stability", help="every method on every way to fail"))
    text = "hashes of many small pictures, to tell whether a change of code changes any"
    add_fingerprint_arguments(commands.add_parser("fingerprints", help=text, description=text))
    text = "how soon a viewport answers, and what it leaves behind"
    add_viewport_arguments(commands.add_parser("viewport", help=text, description=text))
    add_farm_arguments(commands)
    add_file_arguments(commands)
    text = "a viewport beside Cycles' at equal seconds after a move of the camera"
    add_race_arguments(commands.add_parser("viewport-race", help=text, description=text))
    commands.add_parser("scenes", help="list the scenes built by script")
    return parser


def _scenes(arguments: argparse.Namespace, default: list[str]) -> list[SceneSource]:
    return expand(arguments.scenes or [BUILTIN + name for name in default])


def main(arguments: list[str] | None = None) -> int:
    """Run a command; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    if chosen.command == "scenes":
        from benchmarks.scenes import SCENES

        for scene in SCENES.values():
            print(f"{BUILTIN}{scene.name:32} {scene.description}")
        return 0
    if chosen.command == "farm":
        from benchmarks.farm import run as run_farm

        return run_farm(chosen)
    if chosen.command == "viewport":
        from benchmarks.viewport import main as measure_viewport

        return measure_viewport(chosen)
    if chosen.command == "viewport-race":
        from benchmarks.viewport_race import main as race

        return race(chosen)
    if chosen.command in CHART_COMMANDS:
        return run_chart_command(chosen, SHORT_SET)
    from benchmarks.rivals import Budget, find_rival

    if chosen.command in ("files", "fingerprints", "stability"):
        from benchmarks.stability import stability

        command = {"files": files, "fingerprints": fingerprints, "stability": stability}[chosen.command]
        try:
            return 1 if command(chosen) else 0
        except ValueError as error:
            print(f"error: {error}", file=sys.stderr)
            return 2
    common = {"out": chosen.out, "pixels": chosen.pixels, "threads": chosen.threads, "resume": chosen.resume}
    try:
        if chosen.command == "run":
            from benchmarks.run import run

            settings = {"use_nee": False} if chosen.no_nee else {}
            for is_asked, folder in ((chosen.no_nee, "no-nee"), (chosen.at_defaults, "at-defaults")):
                common["out"] /= folder if is_asked else ""
            return (
                1
                if run(
                    _scenes(chosen, SHORT_SET),
                    [find_rival(name, settings) for name in chosen.rivals],
                    Budget(chosen.samples, chosen.seconds, chosen.noise_threshold),
                    chosen.seeds,
                    references=chosen.references,
                    isolate=chosen.isolate, at_defaults=chosen.at_defaults, first_seed=chosen.first_seed,
                    **common,
                )
                else 0
            )
        if chosen.command == "papers":
            from benchmarks.papers import compare_methods

            return (
                1
                if compare_methods(
                    PROTOCOLS[chosen.paper],
                    _scenes(chosen, ["evening-room"]),
                    seed_count=chosen.seeds,
                    methods=chosen.methods,
                    samples=chosen.samples,
                    sample_weighting=chosen.sample_weighting,
                    references=chosen.references,
                    out=chosen.out / chosen.paper,
                    pixels=chosen.pixels,
                    threads=chosen.threads,
                )
                else 0
            )
        if chosen.command == "parity":
            from benchmarks.parity import parity

            scenes = _scenes(chosen, ["*"])
            more = {"most_seeds": chosen.most_seeds, "without_lamps": chosen.without_lamps}
            return 1 if parity(scenes, find_rival(chosen.rival), chosen.samples, chosen.seeds, **common, **more) else 0
        if chosen.command == "first-click":
            from benchmarks.first_click import first_click

            del common["resume"]
            return 1 if first_click(_scenes(chosen, ["limits-*"]), chosen.samples, chosen.seeds, **common) else 0
        if chosen.command == "profile":
            from benchmarks.profiling import profile

            scenes = _scenes(chosen, SHORT_SET[:1])
            del common["resume"]
            profile(scenes, chosen.samples, with_replay=not chosen.no_replay, **common)
            return 0
        if chosen.command == "passes":
            from benchmarks.pass_sheet import pass_sheets

            scenes, rival = _scenes(chosen, ["evening-room"]), find_rival(chosen.rival)
            return 1 if pass_sheets(scenes, rival, chosen.samples, out=chosen.out, pixels=chosen.pixels) else 0
        from benchmarks.gallery import gallery

        return 1 if gallery(_scenes(chosen, ["*"]), find_rival(chosen.rival), chosen.samples, **common) else 0
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2


if __name__ == "__main__":
    sys.exit(main())
