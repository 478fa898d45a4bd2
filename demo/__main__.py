# SPDX-License-Identifier: GPL-3.0-or-later
"""`make demo`: builds the demo scene, renders it with NEURALGUIDE, writes out/demo.exr and out/demo.png."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy

import addon
from addon import engine

from .build_scene import build


def _save(scene: bpy.types.Scene, path: Path, file_format: str) -> None:
    """Save the render result; the PNG goes through Blender's view transform, the EXR is linear."""
    settings = scene.render.image_settings
    settings.file_format = file_format
    settings.color_mode = "RGBA" if file_format == "OPEN_EXR" else "RGB"
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)


def main() -> int:
    """Command line; the exit code is 1 where nothing could be rendered."""
    parser = argparse.ArgumentParser(prog="python -m demo", description=__doc__)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--samples", type=int, default=128)
    parser.add_argument("--output", type=Path, default=Path("out"))
    arguments = parser.parse_args()
    output = arguments.output.resolve()
    output.mkdir(parents=True, exist_ok=True)

    addon.register()
    scene = build(arguments.width, arguments.height, arguments.samples)
    bpy.ops.wm.save_as_mainfile(filepath=str(output / "demo.blend"))
    print("Rendering the demo; the first render ever compiles the kernels, which takes about a minute.", flush=True)
    try:
        bpy.ops.render.render()
    except RuntimeError as error:
        print(f"The demo could not be rendered. {error}", file=sys.stderr)
        return 1
    if not any(outcome.status == "FINISHED" for outcome in engine.outcomes):
        print("The demo was not rendered to its end.", file=sys.stderr)
        return 1
    _save(scene, output / "demo.exr", "OPEN_EXR")
    _save(scene, output / "demo.png", "PNG")
    for name in ("demo.exr", "demo.png", "demo.blend"):
        print(f"wrote {output / name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
