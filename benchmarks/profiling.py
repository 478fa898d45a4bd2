# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks profile`: time and rays per stage, and how near a render comes to bare Embree.

Rays of a one-thread render are recorded and traced again in the same order by a compiled loop around Embree; the ratio
of the two rates is the share of the ray tracing limit that the whole render reaches. `bare_embree.json` keeps bare
Embree's rate by scene, for `report`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

from benchmarks import environment
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource, open_scene
from benchmarks.tables import table

#: In a folder of results: rays that bare Embree traces in a second of one thread, by scene.
BARE_EMBREE_FILE = "bare_embree.json"


def read_bare_rates(folder: Path) -> dict[str, float]:
    """What `profile` has left in a folder, rays a second of one thread by scene; nothing where it was not run."""
    path = folder / BARE_EMBREE_FILE
    return dict(json.loads(path.read_text(encoding="utf-8"))) if path.is_file() else {}


def stage_table(stage_seconds: dict[str, float], thread_seconds: float) -> str:
    """Stages by time; `thread_seconds` is render time times threads, what the stages share."""
    rows: list[list[float | int | str | None]] = [
        [stage, seconds, 100.0 * seconds / thread_seconds]
        for stage, seconds in sorted(stage_seconds.items(), key=lambda item: -item[1])
    ]
    rest = thread_seconds - sum(stage_seconds.values())
    rows.append(["(between stages, waiting)", rest, 100.0 * rest / thread_seconds])
    return table(["stage", "thread s", "%"], rows)


def ray_table(rays: dict[str, int], seconds: float, path_count: int) -> str:
    """Rays by kind, per path and per second of rendering."""
    rows: list[list[float | int | str | None]] = [
        [kind, f"{count:,}", count / max(path_count, 1), count / seconds / 1e6] for kind, count in rays.items()
    ]
    total = sum(rays.values())
    rows.append(["all", f"{total:,}", total / max(path_count, 1), total / seconds / 1e6])
    return table(["rays", "count", "per path", "M/s"], rows)


def profile(
    sources: Sequence[SceneSource], samples: int, *, out: Path, pixels: int = 0, threads: int = 0,
    with_replay: bool = True,
) -> None:  # fmt: skip
    """Render each scene with the session itself and print where the time went; rates of bare Embree go to `out`."""
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings
    from engine.render.replay import RayRecorder
    from engine.render.session import Session

    threads = threads or environment.thread_count()
    for source in sources:
        scene = open_scene(source, pixels)
        find_rival("OFF").configure(scene, Budget(samples), 1, threads)
        session = Session(render_settings(scene))
        session.load(export_scene(bpy.context.evaluated_depsgraph_get()))
        session.render()  # kernels loaded, caches warm
        report = session.render().report
        triangles = sum(len(mesh.triangles) for mesh in session.scene.description.meshes) if session.scene else 0
        size = f"{scene.render.resolution_x}x{scene.render.resolution_y}"
        print(
            f"\n{source.name}, {size}, {report.sample_count:.0f} spp, {triangles:,} triangles, "
            f"{report.thread_count} threads: {report.render_seconds:.2f} s, "
            f"{report.path_count / report.render_seconds / 1e6:.3f} Mpaths/s\n"
        )
        print(stage_table(report.stage_seconds, report.render_seconds * report.thread_count))
        print()
        print(ray_table(report.rays, report.render_seconds, report.path_count))
        if with_replay and session.scene is not None:
            find_rival("OFF").configure(scene, Budget(samples), 1, 1)
            session.settings = render_settings(scene)
            single = session.render().report
            recorder = RayRecorder()
            session.render(ray_observer=recorder.observe)
            bare = min(recorder.replay(session.scene, 1) for _ in range(3))
            bare_rate = recorder.count / bare
            out.mkdir(parents=True, exist_ok=True)
            rates = {**read_bare_rates(out), source.name: bare_rate}
            (out / BARE_EMBREE_FILE).write_text(json.dumps(rates, indent=1) + "\n", encoding="utf-8")
            rate = sum(single.rays.values()) / single.render_seconds
            print(
                f"\nOne thread: {rate / 1e6:.2f} Mrays/s in the render, {bare_rate / 1e6:.2f} Mrays/s by bare Embree "
                f"on {recorder.count:,} of its rays: {100.0 * rate / bare_rate:.0f}% of the limit"
            )
        session.close()
