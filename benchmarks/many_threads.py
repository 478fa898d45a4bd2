# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.many_threads`: what sixteen and sixty-four threads would wait for (`virtual_threads`)."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource, expand, open_scene
from benchmarks.tables import table

COUNTS = (1, 4, 16, 64)


def many_threads(sources: Sequence[SceneSource], samples: int, *, pixels: int, methods: Sequence[str]) -> None:
    """Render each scene by each method with each number of virtual threads, and print how busy they would be.

    Parameters
    ----------
    methods : sequence of str
        `METHOD` or `METHOD-CACHE`.
    """
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings
    from benchmarks.virtual_threads import Timeline, VirtualSession

    for source in sources:
        scene = open_scene(source, pixels)
        find_rival("OFF").configure(scene, Budget(samples), 1, 1)
        base = replace(render_settings(scene), threads=1)
        description = export_scene(bpy.context.evaluated_depsgraph_get())
        rows: list[list[float | int | str | None]] = []
        for name in methods:
            method, _, cache = name.partition("-")
            settings = replace(base, guiding_method=method, radiance_cache=cache or "OFF")
            session = VirtualSession(settings, Timeline(1))
            session.load(description)
            session.render()  # kernels loaded, caches warm
            for count in COUNTS:
                line = session.timeline = Timeline(count)
                session.render()
                rows.append(
                    [
                        name,
                        count,
                        line.seconds,
                        100.0 * line.busy,
                        line.speedup,
                        1000.0 * line.learning / max(line.learned_count, 1),
                        line.learned_count,
                        100.0 * line.interpreter / line.seconds,
                    ]
                )
            session.close()
        print(f"\n{source.name}, {scene.render.resolution_x}x{scene.render.resolution_y}, {samples} samples\n")
        print(
            table(
                [
                    "method",
                    "threads",
                    "s",
                    "busy %",
                    "over one",
                    "ms a learning",
                    "learnings",
                    "interpreter % of the time",
                ],
                rows,
            )
        )


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns the exit status."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("scenes", nargs="+")
    parser.add_argument("--methods", nargs="+", default=["OFF", "VMM", "AUTO", "AUTO-CONVERGING"])
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--pixels", type=int, default=57600)
    chosen = parser.parse_args(arguments)
    many_threads(expand(chosen.scenes), chosen.samples, pixels=chosen.pixels, methods=chosen.methods)
    return 0


if __name__ == "__main__":
    sys.exit(main())
