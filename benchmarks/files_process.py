# SPDX-License-Identifier: GPL-3.0-or-later
"""One file of `files` in this process: `python -m benchmarks.files_process TASK`, TASK in JSON.

Pictures of both renderers go to `FOLDER/SETTINGS_RIVAL_SEED.exr`, what was added and said to `FOLDER/file.json`.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from benchmarks.framing import complete
from benchmarks.rendering import RenderRecord, render_once
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource

#: How clamps are set: all off, or as the file has them.
SETTINGS = ("unclamped", "own")
RIVALS = ("cycles", "OFF")


def _open(file: str, width: int) -> Any:
    """Open a file, none of whose scripts run, with its longer side scaled to `width` pixels."""
    import bpy

    bpy.ops.wm.open_mainfile(filepath=file, load_ui=False, use_scripts=False)
    scene = bpy.context.scene
    render = scene.render
    longer = max(render.resolution_x, render.resolution_y)
    render.resolution_x = max(round(render.resolution_x * width / longer), 1)
    render.resolution_y = max(round(render.resolution_y * width / longer), 1)
    render.resolution_percentage = 100
    return scene


def main(task: str) -> int:
    """Render what `task` says; returns the exit status."""
    import bpy

    asked = json.loads(task)
    folder, source = Path(asked["folder"]), SceneSource(asked["file"])
    scene = _open(asked["file"], asked["width"])
    facts: dict[str, Any] = {
        "added": complete(scene), "version": list(bpy.data.version), "notices": [], "engine": scene.render.engine,
    }  # fmt: skip
    own = scene.cycles.sample_clamp_direct, scene.cycles.sample_clamp_indirect
    try:
        for seed in range(asked["first_seed"], asked["first_seed"] + asked["seeds"]):
            for settings in SETTINGS:
                clamps = own if settings == "own" else (0.0, 0.0)
                scene.cycles.sample_clamp_direct, scene.cycles.sample_clamp_indirect = clamps
                for name in RIVALS:
                    record = RenderRecord(
                        source.name, "", name, seed, scene.render.resolution_x, scene.render.resolution_y,
                        asked["samples"], 0.0, asked["threads"],
                    )  # fmt: skip
                    exr = folder / f"{settings}_{name}_{seed}.exr"
                    render_once(scene, find_rival(name), Budget(asked["samples"]), record, exr)
                    facts["notices"] = record.details.get("notices", facts["notices"])
    except (RuntimeError, ValueError) as error:
        print(str(error).strip(), file=sys.stderr)
        return 1
    (folder / "file.json").write_text(json.dumps(facts, indent=1) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
