# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks farm`: how far a cluster scales: what its parts cost here, and a simulation made of that.

Costs are times of processors, which other programs on the machine do not change much. Renders by local workers are
measured by the clock; on a machine whose cores they share with the coordinator they say little.
"""

from __future__ import annotations

import argparse
import json
import logging
import time
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from benchmarks import environment
from benchmarks.farm_model import Costs, Frame, simulate
from benchmarks.scene_files import BUILTIN, SceneSource, open_scene
from benchmarks.tables import table

_SCENE = "diffuse"
_PIXELS = 40_000
_SAMPLES = 64
_REPEATS = 5
_WORKERS = (1, 2, 4, 8, 16, 32, 64, 128, 256, 512, 1000)
_THREADS = 16
_GIGABIT = 1e9 / 8
_UNGUIDED, _GUIDED = Frame(3840, 2160, 1024, False), Frame(3840, 2160, 1024, True)
#: Simulated renders by what they are called: link, and how many times as dear paths are as those measured.
_CASES = {
    "unguided": (_UNGUIDED, 10 * _GIGABIT, 1),
    "guided": (_GUIDED, 10 * _GIGABIT, 1),
    "guided, 1 Gbit/s": (_GUIDED, _GIGABIT, 1),
    "unguided, paths ten times as dear": (_UNGUIDED, 10 * _GIGABIT, 10),
    "guided, paths ten times as dear": (_GUIDED, 10 * _GIGABIT, 10),
}


def add_arguments(commands: Any) -> None:
    """Add the command to the subparsers of an `argparse.ArgumentParser`."""
    command = commands.add_parser("farm", help="how far a cluster scales", description=__doc__)
    command.add_argument("--workers", type=int, nargs="*", default=[], help="also render with so many local workers")
    command.add_argument("--out", type=Path, default=Path("out/farm"), help="folder (default: %(default)s)")


def _scene() -> tuple[Any, Any]:
    """Description and settings of the scene that is measured."""
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings
    from benchmarks.rivals import Budget, find_rival

    open_scene(SceneSource(f"{BUILTIN}{_SCENE}"), _PIXELS)
    scene = bpy.context.scene
    find_rival("VMM").configure(scene, Budget(_SAMPLES, 0.0), 1, 1)
    settings = replace(render_settings(scene), guiding_trial=False, deterministic=True)
    return export_scene(bpy.context.evaluated_depsgraph_get()), settings


def _answer(size: int) -> bytes:
    return bytes(size)


def scheduler_costs(task_count: int = 2000, size: int = 1 << 20) -> tuple[float, float, float]:
    """Processor time [s] of scheduler and client a task and a byte, and tasks a second by the clock, of Dask."""
    from distributed import Client, LocalCluster, as_completed

    def run(count: int, payload: int) -> tuple[float, float]:
        began, clock = time.process_time(), time.perf_counter()
        futures = [
            client.submit(_answer, payload, pure=False, workers=[names[index % len(names)]]) for index in range(count)
        ]
        for future in as_completed(futures):
            future.result()
        return time.process_time() - began, time.perf_counter() - clock

    with LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, protocol="tcp://",
        silence_logs=logging.CRITICAL,
    ) as cluster, Client(cluster, direct_to_workers=True) as client:
        names = list(client.nthreads())
        run(100, 0)
        seconds, wall = run(task_count, 0)
        count = 100
        with_bytes, _ = run(count, size)
    per_task = seconds / task_count
    return per_task, max(with_bytes / count - per_task, 0.0) / size, task_count / wall


def ticket_cost(worker_count: int = 1000) -> float:
    """Processor time [s] of handing out one range, a worker that there is."""
    from engine.cluster.dispatcher import Dispatcher
    from engine.cluster.ranges import TaskRange

    dispatcher = Dispatcher(20.0)
    dispatcher.meet(frozenset(f"tcp://{index}" for index in range(worker_count)))
    began = time.process_time()
    tickets = []
    for number in range(worker_count):
        name = dispatcher.idlest()
        assert name is not None
        tickets.append(dispatcher.assign(name, TaskRange(number, (), 1), 0.0))
    for ticket in tickets:
        dispatcher.take_back(ticket, 1.0, is_done=True)
    return (time.process_time() - began) / worker_count**2


def render_costs() -> dict[str, float]:
    """What a guided render costs a path, a pixel of a task and a round, and what is sent of it."""
    from engine.cluster.work import pack_guidance, pack_traced, unpack_traced
    from engine.guiding.policy.guidance import Guidance
    from engine.guiding.policy.rules import RULES
    from engine.guiding.policy.trial import ArmSamples
    from engine.render.film import Film
    from engine.render.render_loop import RenderLoop
    from engine.render.request import RenderRequest
    from engine.render.session import Session
    from engine.render.tiles import FrameTiles
    from engine.state.unit import CURRENT

    description, settings = _scene()
    session = Session(settings)
    session.load(description)
    result = session.render()
    report = result.report
    assert result.guidance is not None
    frame = description.frame
    x0, y0, x1, y1 = frame.region
    layout = Film(x1 - x0, y1 - y0).layout
    tiles = [pixels for pixels, _ in FrameTiles(frame)[:]]
    traced, _ = session.trace_tiles(
        settings, layout, tiles, ArmSamples(0, 1, CURRENT), 0, Guidance(settings, 2**32), records=True
    )
    packed = pack_traced(traced)
    count, sums, _, _, vertices, _ = packed
    times = []
    for _ in range(_REPEATS):
        loop = RenderLoop(RenderRequest(frame, settings), Film(x1 - x0, y1 - y0), 1, lambda guidance: None)
        loop.ready()
        tasks = [loop.take() for _ in tiles]
        began = time.process_time()
        again = unpack_traced(packed, layout)
        loop.keep_alike(tasks, [loop.unit(task) for task in tasks], again.sums, again.costs, again.records)
        times.append((time.process_time() - began) / count)
        assert loop.learner is not None
        loop.learner.close()
    pixel_seconds = min(times)
    session.close()
    return {
        "path_seconds": sum(report.stage_seconds.values()) / report.path_count,
        "pixel_seconds": pixel_seconds,
        "learning_seconds": report.guiding.field_seconds / report.guiding.record_count * RULES.records_per_iteration,
        "pixel_bytes": sum(column.nbytes for column in sums if column is not None) / count,
        "record_bytes": sum(column.nbytes for column in vertices) / max(len(vertices[3]), 1),
        "guidance_bytes": float(len(pack_guidance(result.guidance))),
    }


def local_renders(counts: list[int]) -> list[dict[str, float]]:
    """Seconds of the same guided render by so many local workers of one thread; the first of each loads kernels."""
    from engine.cluster.dask_pool import open_pool
    from engine.cluster.session import ClusterSession

    description, settings = _scene()
    found = []
    for count in counts:
        pool = open_pool(f"local:{count}", threads=1)
        try:
            session = ClusterSession(settings, pool)
            session.load(description)
            session.render(samples=7)
            found.append({"workers": count, "seconds": session.render().report.render_seconds})
        finally:
            pool.close()
    return found


def draw(times: dict[str, list[float]], path: Path) -> None:
    """Speed over one worker against the number of workers."""
    from matplotlib.backends.backend_svg import FigureCanvasSVG
    from matplotlib.figure import Figure

    figure = Figure(figsize=(6.4, 4.2), layout="constrained")
    FigureCanvasSVG(figure)
    panel = figure.subplots()
    panel.plot(_WORKERS, _WORKERS, color="0.7", label="as many times as fast as there are workers")
    for name, seconds in times.items():
        panel.plot(_WORKERS, [seconds[0] / value for value in seconds], "o-", ms=3, label=name)
    panel.set(xscale="log", yscale="log", xlabel=f"workers of {_THREADS} threads", ylabel="times as fast as one")
    panel.set_title("One frame of 3840 x 2160, 1024 samples, 10 Gbit/s but where said (simulated)", fontsize=9)
    panel.grid(alpha=0.3)
    panel.legend(fontsize=8)
    figure.savefig(path, metadata={"Date": None})


def run(chosen: argparse.Namespace) -> int:
    """Measure, simulate, write `farm.json` and `farm.svg`, and print what comes out."""
    folder: Path = chosen.out
    folder.mkdir(parents=True, exist_ok=True)
    task_seconds, byte_seconds, tasks_a_second = scheduler_costs()
    costs = Costs(
        task_seconds=task_seconds, byte_seconds=byte_seconds, ticket_seconds=ticket_cost(), **render_costs()
    )
    times = {
        name: [
            simulate(frame, count, _THREADS, link, replace(costs, path_seconds=times * costs.path_seconds))
            for count in _WORKERS
        ]
        for name, (frame, link, times) in _CASES.items()
    }
    local = local_renders(chosen.workers)
    content = {
        "environment": environment.describe(), "costs": asdict(costs), "tasks_a_second": tasks_a_second,
        "workers": _WORKERS, "threads": _THREADS, "seconds": times, "local": local,
    }
    (folder / "farm.json").write_text(json.dumps(content, indent=1, default=str) + "\n", "utf-8")
    draw(times, folder / "farm.svg")
    print(table(["cost", "figure"], [[name, f"{value:.3g}"] for name, value in asdict(costs).items()]))
    print(f"\n{1 / task_seconds:.0f} tasks a second of processor time, {tasks_a_second:.0f} by the clock\n")
    megabytes = _GUIDED.round_bytes(costs) / 1e6
    print(f"{megabytes:.0f} MB a round of 3840 x 2160, {costs.guidance_bytes / 1e6:.1f} MB back\n")
    rows = [
        [name, *(f"{seconds[0] / value:.3g}" for value in seconds)] for name, seconds in times.items()
    ]
    print(table(["times as fast as one worker", *map(str, _WORKERS)], rows))
    for item in local:
        print(f"{item['workers']} local workers: {item['seconds']:.1f} s")
    return 0
