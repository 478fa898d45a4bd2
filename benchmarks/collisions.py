# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.collisions builtin:media-door`: what would guiding where paths collide with media bring?

By the records of a guided render: nothing is guided in a new way. See `benchmarks.segment_moments`.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace

import numpy as np

from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import expand, open_scene
from benchmarks.segment_moments import (
    Segments,
    blocks_of_picture,
    camera_segments,
    cells_of_space,
    cut,
    later_segments,
    moment_left,
)
from engine.array_types import Int64Array
from engine.guiding.records.vertices import VertexRecords, join_records

_INTERVALS = 4
_BLOCKS = (1, 8, 16)
_DEPTHS = (0, 3, 6)


class _Keeper:
    """Keeps the records of all iterations but the first, in which nothing is guided."""

    def __init__(self) -> None:
        self.taken: list[VertexRecords] = []

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Keep an iteration's."""
        self.taken.append(VertexRecords(*(np.array(column[:row_count]) for column in records)))


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.collisions", description="What would guiding where paths collide with media bring?"
    )
    parser.add_argument("scenes", nargs="+", help=".blend files or builtin:NAME, whose media are the same everywhere")
    parser.add_argument("--samples", type=int, default=63, help="a pixel (default: %(default)s)")
    parser.add_argument("--pixels", type=int, default=2500, help="of the picture (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    return parser


def _print_segments(kind: str, segments: Segments, cells: list[Int64Array]) -> None:
    squares = cut(segments.found) ** 2
    collided = segments.collided
    if not collided.any() or collided.all() or not squares.sum() > 0.0:
        print(f"  {kind}: no segment collides, or none passes")
        return
    ratio = squares[collided].mean() / squares[~collided].mean()
    share = squares[collided].sum() / squares.sum()
    print(f"  {kind}: {len(squares)} segments, {collided.mean():.3f} collide, with {share:.2f} of the second moment;")
    print(f"    behind a collision it is {ratio:.2f} times what it is behind those that pass")
    print(f"    {'cells':>6} {'collide or pass':>16} {f'and {_INTERVALS} distances':>16}")
    for of_segment in cells:
        _, of_segment = np.unique(of_segment, return_inverse=True)
        left = [moment_left(segments, of_segment, count) for count in (1, _INTERVALS)]
        print(f"    {of_segment.max() + 1:6d} {left[0]:16.3f} {left[1]:16.3f}")


def main(arguments: list[str] | None = None) -> int:
    """Render, and print what is left of the second moment; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    try:
        import bpy

        from addon.export import export_scene
        from addon.properties import render_settings
        from engine.render.session import Session

        for source in expand(chosen.scenes):
            scene = open_scene(source, chosen.pixels)
            find_rival("VMM").configure(scene, Budget(chosen.samples), chosen.seed, chosen.threads)
            settings = replace(render_settings(scene), guiding_trial=False, spectral="OFF")
            description = export_scene(bpy.context.evaluated_depsgraph_get())
            session, keeper = Session(settings), _Keeper()
            session.load(description)
            session.render(sink=keeper)
            session.close()
            records, row_count = join_records(keeper.taken[1:] or keeper.taken)
            print(f"{source.name}, {chosen.samples} samples: second moment that the best choice would leave")
            seen = camera_segments(records, row_count, np.asarray(description.camera.transform)[:3, 3])
            _print_segments("from the camera", seen, [blocks_of_picture(seen, side) for side in _BLOCKS])
            later = later_segments(records, row_count)
            _print_segments("later", later, [cells_of_space(later, depth) for depth in _DEPTHS])
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    return 0


if __name__ == "__main__":
    sys.exit(main())
