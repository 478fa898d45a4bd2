# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks scaling`: how cost grows with what a scene and its settings ask for.

Scenes are built by script, one quantity grows, all else stays. Renders are stopped by time, so that no step takes long;
cost is what a sample, path or ray took then. A power is fitted to each curve.
"""

from __future__ import annotations

import datetime
import json
import statistics
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks import environment
from benchmarks.rivals import Budget, find_rival
from benchmarks.scaling_fit import SCALING_FILE, Curve
from benchmarks.tables import table

if TYPE_CHECKING:
    from engine.render.report import RenderReport

_BASE_SIZE = (128, 96)
#: Small, so that a short render comes as far as to learn.
_GUIDED_SIZE = (48, 36)


@dataclass(frozen=True)
class Effort:
    """How long measuring may take.

    seconds : of each render
    repeats : of each step, whose median counts
    stride : every how many-th step is taken
    """

    seconds: float
    repeats: int
    stride: int

    def thin(self, steps: Sequence[int]) -> list[int]:
        """The steps to take: every `stride`-th, first and last always."""
        return sorted({*steps[:: self.stride], steps[-1]})


FULL = Effort(1.5, 3, 1)
QUICK = Effort(0.5, 2, 2)


def _reports(effort: Effort, threads: int, size: tuple[int, int] = _BASE_SIZE, **settings: Any) -> list[RenderReport]:
    """Reports of repeated renders of the open scene, stopped by time, after one that loads kernels."""
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings
    from engine.render.session import Session

    scene = bpy.context.scene
    scene.render.resolution_x, scene.render.resolution_y = size
    bpy.context.view_layer.update()
    find_rival("OFF").configure(scene, Budget(1, effort.seconds), 1, threads)
    chosen = replace(render_settings(scene), **settings)
    session = Session(chosen)
    session.load(export_scene(bpy.context.evaluated_depsgraph_get()))
    session.settings = replace(chosen, time_limit=0.0, samples=1)
    session.render()
    session.settings = chosen
    reports = [session.render().report for _ in range(effort.repeats)]
    session.close()
    return reports


def seconds_per_sample(reports: Sequence[RenderReport]) -> float:
    """Median over renders of the time of a sample of every pixel [s]."""
    return statistics.median(r.render_seconds / max(r.sample_count, 1e-9) for r in reports)


def nanoseconds_per_ray(reports: Sequence[RenderReport]) -> float:
    """Median over renders of the thread time of a ray [ns], everything included."""
    return statistics.median(
        1e9 * r.render_seconds * r.thread_count / max(sum(r.rays.values()), 1) for r in reports
    )


def resolution_curves(effort: Effort, threads: int) -> list[Curve]:
    """Seconds per sample against pixels."""
    from benchmarks.scenes import growing

    growing.stage()
    xs, ys = [], []
    for width in effort.thin([32, 64, 128, 256, 512]):
        size = (width, 3 * width // 4)
        xs.append(float(size[0] * size[1]))
        ys.append(seconds_per_sample(_reports(effort, threads, size)))
    return [Curve("resolution", "OFF", "pixels", "seconds per sample", xs, ys)]


def triangle_curves(effort: Effort, threads: int) -> list[Curve]:
    """Time of a ray, and of building the scene, against triangles."""
    from benchmarks.scenes import growing

    xs, rays, builds = [], [], []
    for wanted in effort.thin([128, 1_000, 8_000, 64_000, 512_000]):
        xs.append(float(growing.terrain(wanted)))
        reports = _reports(effort, threads)
        rays.append(nanoseconds_per_ray(reports))
        builds.append(reports[0].build_seconds)
    return [
        Curve("triangles, tracing", "OFF", "triangles", "ns per ray", xs, rays),
        Curve("triangles, building", "OFF", "triangles", "seconds", xs, builds),
    ]


def light_curves(effort: Effort, threads: int) -> list[Curve]:
    """Time of a ray against emitting triangles."""
    from benchmarks.scenes import growing

    xs, ys = [], []
    for count in effort.thin([1, 8, 64, 512, 4096, 32_768]):
        growing.lamps(count)
        xs.append(float(count))
        ys.append(nanoseconds_per_ray(_reports(effort, threads)))
    return [Curve("lights", "OFF", "emitting triangles", "ns per ray", xs, ys)]


def thread_curves(effort: Effort, threads: int) -> list[Curve]:
    """Seconds per sample against threads; -1 is perfect. Nothing on a machine with one core."""
    from benchmarks.scenes import growing

    growing.stage()
    steps = sorted({2**k for k in range(8) if 2**k < threads} | {threads})
    if len(steps) < 2:
        return []
    ys = [seconds_per_sample(_reports(effort, count)) for count in steps]
    return [Curve("threads", "OFF", "threads", "seconds per sample", [float(count) for count in steps], ys)]


def depth_curves(effort: Effort, threads: int) -> list[Curve]:
    """Seconds per sample against the longest path, in a closed room and without roulette."""
    from benchmarks.scenes import growing

    growing.closed_box()
    xs, ys = [], []
    for depth in effort.thin([1, 2, 4, 8, 16, 32]):
        limits = ("max_bounces", "diffuse_bounces", "glossy_bounces", "transmission_bounces")
        settings: dict[str, Any] = {"use_russian_roulette": False, **dict.fromkeys(limits, depth)}
        xs.append(float(depth + 1))
        ys.append(seconds_per_sample(_reports(effort, threads, **settings)))
    return [Curve("path depth", "OFF", "scatterings", "seconds per sample", xs, ys)]


def candidate_curves(effort: Effort, threads: int) -> list[Curve]:
    """Seconds per sample against candidates of every vertex, learning included."""
    from benchmarks.scenes import growing

    growing.closed_box()
    guided = {"guiding_method": "VMM_RIS", "candidate_allocation": "FIXED", "guiding_trial": False}
    xs, ys = [], []
    for count in effort.thin([1, 2, 4, 8, 16, 32]):
        settings: dict[str, Any] = {**guided, "max_bounces": 4, "candidate_count": count}
        xs.append(float(count))
        ys.append(seconds_per_sample(_reports(effort, threads, _GUIDED_SIZE, **settings)))
    return [Curve("candidates", "VMM_RIS", "candidates a vertex", "seconds per sample", xs, ys)]


def network_curves(effort: Effort, threads: int) -> list[Curve]:
    """Time of asking the radiance network about a direction against its multiplications, on one thread."""
    from engine.guiding.neural.networks.perceptron import MAX_WIDTH, allocate_scratch
    from engine.guiding.neural.networks.radiance import NetworkShape, Snapshot, initial_parameters
    from engine.guiding.neural.networks.radiance_query import make_network_field, predict_network

    rng = np.random.default_rng(5)
    vertices, per_vertex = 2048, 8
    positions = rng.random((vertices, 3)).astype(np.float32)
    directions = rng.normal(size=(vertices * per_vertex, 3))
    directions = (directions / np.linalg.norm(directions, axis=1, keepdims=True)).astype(np.float32)
    nowhere = np.zeros(vertices, np.float32)
    owner = np.repeat(np.arange(vertices, dtype=np.int64), per_vertex)
    latent, scratch = np.zeros((2, MAX_WIDTH), np.float32), allocate_scratch(MAX_WIDTH)
    bounds = np.array(((0.0, 0.0, 0.0), (1.0, 1.0, 1.0)), np.float32)
    out = np.zeros((len(owner), 3), np.float32)
    xs, ys = [], []
    for width in effort.thin([16, 32, 48, 64, 96, 128]):
        shape = NetworkShape(level_count=4, finest_resolution=64, table_size=1 << 14, width=width, hidden_layers=3)
        field = make_network_field(shape, Snapshot(1, 1, 0.5, 1.0, bounds, initial_parameters(shape, 1)))

        def ask(field: Any = field) -> float:
            start = time.perf_counter()
            predict_network(
                field, positions, nowhere, nowhere, owner, directions, len(owner), latent, scratch, out
            )
            return time.perf_counter() - start

        ask()
        seconds = statistics.median(ask() for _ in range(max(int(20 * effort.seconds), 3)))
        # The first layer is shared by a vertex's candidates, but for the directions' nine rows.
        shared = shape.position_width * width / per_vertex
        xs.append(shared + 9 * width + (shape.hidden_layers - 1) * width**2 + width * shape.channel_count)
        ys.append(1e9 * seconds / len(owner))
    return [Curve("network size", "NEURAL_RIS", "multiplications a candidate", "ns per candidate", xs, ys)]


CURVES: dict[str, Callable[[Effort, int], list[Curve]]] = {
    "resolution": resolution_curves,
    "triangles": triangle_curves,
    "lights": light_curves,
    "threads": thread_curves,
    "depth": depth_curves,
    "candidates": candidate_curves,
    "network": network_curves,
}


def scaling_table(curves: Sequence[Curve]) -> str:
    """A line a curve: exponent with its standard error, and the costs at both ends."""
    rows: list[list[float | int | str | None]] = [
        [
            c.name, c.rival, c.x, c.y, c.fit.exponent, c.fit.standard_error, len(c.xs), f"{c.xs[0]:g} to {c.xs[-1]:g}",
            c.ys[0], c.ys[-1],
        ]
        for c in curves
    ]  # fmt: skip
    return table(["cost against", "rival", "x", "y", "exponent", "±", "steps", "range", "first", "last"], rows)


def scaling(*, out: Path, threads: int = 0, is_quick: bool = False, only: Sequence[str] = ()) -> list[Curve]:
    """Measure, print, write `out/scaling.json`.

    Parameters
    ----------
    only : names out of CURVES; none: all
    """
    threads = threads or environment.thread_count()
    effort = QUICK if is_quick else FULL
    curves: list[Curve] = []
    for name in only or CURVES:
        started = time.monotonic()
        curves += CURVES[name](effort, threads)
        print(f"  {name}: {time.monotonic() - started:.0f} s", flush=True)
    facts = environment.describe()
    print(f"\n{threads} threads, commit {facts['commit']}, {facts['cpu']}\n\n{scaling_table(curves)}")
    out.mkdir(parents=True, exist_ok=True)
    stored = {
        "environment": facts,
        "threads": threads,
        "is_quick": is_quick,
        "date": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "curves": [curve.stored() for curve in curves],
    }
    (out / SCALING_FILE).write_text(json.dumps(stored, indent=1) + "\n", encoding="utf-8")
    return curves
