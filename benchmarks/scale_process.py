# SPDX-License-Identifier: GPL-3.0-or-later
"""One render of `scale` in this process: `python -m benchmarks.scale_process TASK JSON`, TASK in JSON."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from benchmarks import environment
from benchmarks.rendering import RenderRecord, render_once
from benchmarks.rivals import Budget, find_rival
from benchmarks.scale import CASES, ScaleRecord

#: Those that both renderers have and that take the most room.
_PASSES = (
    "z", "position", "normal", "vector", "uv", "mist", "object_index", "material_index", "diffuse_direct",
    "diffuse_indirect", "diffuse_color", "glossy_direct", "glossy_indirect", "glossy_color", "transmission_direct",
    "transmission_indirect", "transmission_color", "emit", "environment", "cryptomatte_object", "cryptomatte_material",
)  # fmt: skip


def ask_for_passes(layer: Any) -> None:
    """Switch passes on."""
    for name in _PASSES:
        setattr(layer, f"use_pass_{name}", True)


def main(task: str, out: str) -> int:
    """Build and render what `task` says; returns the exit status."""
    import bpy

    asked = json.loads(task)
    record = ScaleRecord(**asked["record"])
    case, folder = CASES[record.case], Path(asked["folder"])
    case.build(record.count, folder)
    scene = bpy.context.scene
    width, height = scene.render.resolution_x, scene.render.resolution_y = case.frame(record.count)
    if case.with_passes:
        ask_for_passes(bpy.context.view_layer)
    bpy.context.view_layer.update()
    environment.reset_peak_memory()
    record.scene_mib = environment.peak_memory_mib()
    render = RenderRecord(
        record.case, "", record.rival, 1, width, height, case.samples, 0.0, asked["threads"],
    )  # fmt: skip
    exr = folder / f"{record.case}-{record.count}-{record.rival}.exr"
    try:
        render_once(scene, find_rival(record.rival), Budget(case.samples), render, exr)
    except (RuntimeError, ValueError) as error:
        print(str(error).strip(), file=sys.stderr)
        return 1
    record.peak_mib, record.wall_seconds = render.peak_memory_mib, render.wall_seconds
    record.export_seconds, record.render_seconds = render.export_seconds, render.render_seconds
    Path(out).write_text(json.dumps(asdict(record)) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
