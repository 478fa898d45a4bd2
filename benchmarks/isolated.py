# SPDX-License-Identifier: GPL-3.0-or-later
"""One render in this process, for `--isolate`: `python -m benchmarks.isolated TASK EXR`, TASK in JSON."""

from __future__ import annotations

import json
import sys
from pathlib import Path

from benchmarks.rendering import RenderRecord, render_once
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource, open_scene


def main(task: str, exr: str) -> int:
    """Render what `task` says; returns the exit status."""
    asked = json.loads(task)
    record = RenderRecord(**asked["record"])
    scene = open_scene(SceneSource(asked["source"]), size=(record.width, record.height))
    try:
        render_once(scene, find_rival(record.rival, record.settings), Budget(**asked["budget"]), record, Path(exr))
    except (RuntimeError, ValueError) as error:
        print(str(error).strip(), file=sys.stderr)
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
