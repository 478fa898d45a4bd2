# SPDX-License-Identifier: GPL-3.0-or-later
"""`make demo`: renders a room by NeuralGuide and by Cycles in the same seconds, and says by how much each is off."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import bpy

import addon
from addon import engine
from benchmarks.scenes.interiors.study import build

from .compare import error_against, save_pair

REFERENCE = Path(__file__).with_name("reference.exr")
#: Paths a pixel, and the seed, of the picture that both are compared with.
_REFERENCE_SAMPLES, _REFERENCE_SEED = 320, 71


def _save(scene: bpy.types.Scene, path: Path, file_format: str) -> None:
    """Save the render result; a PNG goes through Blender's view transform, an EXR is linear."""
    settings = scene.render.image_settings
    settings.file_format = file_format
    settings.color_mode = "RGBA" if file_format == "OPEN_EXR" else "RGB"
    settings.color_depth = "16" if file_format == "OPEN_EXR" else "8"
    bpy.data.images["Render Result"].save_render(str(path), scene=scene)


def _render_ours(scene: bpy.types.Scene) -> bool:
    """Render by NeuralGuide; whether it came to its end."""
    scene.render.engine = "NEURALGUIDE"
    count = engine.outcome_count()
    bpy.ops.render.render()
    return any(outcome.status == "FINISHED" for outcome in engine.outcomes_since(count))


def _render_cycles(scene: bpy.types.Scene) -> None:
    scene.render.engine = "CYCLES"
    scene.cycles.device = "CPU"
    bpy.ops.render.render()


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="python -m demo", description=__doc__)
    parser.add_argument("--width", type=int, default=640)
    parser.add_argument("--height", type=int, default=360)
    parser.add_argument("--seconds", type=float, default=20.0, help="time of each renderer")
    parser.add_argument("--output", type=Path, default=Path("out"))
    parser.add_argument("--reference", action="store_true", help="only render anew what both are compared with")
    return parser.parse_args()


def _make_reference(scene: bpy.types.Scene) -> bool:
    """Render the picture that both are compared with, for minutes."""
    scene.cycles.samples, scene.cycles.seed, scene.cycles.time_limit = _REFERENCE_SAMPLES, _REFERENCE_SEED, 0.0
    if not _render_ours(scene):
        return False
    scene.render.image_settings.exr_codec = "ZIP"
    _save(scene, REFERENCE, "OPEN_EXR")
    print(f"wrote {REFERENCE}")
    return True


def _compare(output: Path, seconds: float) -> None:
    """Say how far both pictures are off, and put them side by side."""
    names = {"Cycles": "cycles", "NeuralGuide": "demo"}
    errors = error_against(REFERENCE, [output / f"{name}.exr" for name in names.values()])
    captions = [f"{name}, {seconds:g} s" for name in names]
    if errors is not None:
        captions = [f"{caption}: error {error:.2g}" for caption, error in zip(captions, errors, strict=True)]
        theirs, ours = errors
        print(
            f"\nAfter {seconds:g} s each, denoised, the error is {theirs:.2g} with Cycles and {ours:.2g} with "
            f"NeuralGuide: {theirs / ours:.1f} times less.\n(Mean squared difference to a picture of "
            f"{_REFERENCE_SAMPLES} paths a pixel, relative to the squared brightness.)\n"
        )
    save_pair([output / f"{name}.png" for name in names.values()], captions, output / "pair.png")


def main() -> int:
    """Command line; the exit code is 1 where nothing could be rendered."""
    arguments = _arguments()
    output = arguments.output.resolve()
    output.mkdir(parents=True, exist_ok=True)
    addon.register()
    scene = build(arguments.width, arguments.height)
    scene.cycles.use_denoising = True
    scene.cycles.time_limit = arguments.seconds
    bpy.ops.wm.save_as_mainfile(filepath=str(output / "demo.blend"))
    print("Rendering the demo; the first render compiles the kernels, which takes a good minute.", flush=True)
    try:
        if arguments.reference:
            return 0 if _make_reference(scene) else 1
        if not _render_ours(scene):
            print("The demo was not rendered to its end.", file=sys.stderr)
            return 1
        for name, file_format in (("demo.exr", "OPEN_EXR"), ("demo.png", "PNG")):
            _save(scene, output / name, file_format)
        print(f"Rendering the same by Cycles, for {arguments.seconds:g} s.", flush=True)
        _render_cycles(scene)
        for name, file_format in (("cycles.exr", "OPEN_EXR"), ("cycles.png", "PNG")):
            _save(scene, output / name, file_format)
    except RuntimeError as error:
        print(f"The demo could not be rendered. {error}", file=sys.stderr)
        return 1
    _compare(output, arguments.seconds)
    for name in ("pair.png", "demo.png", "cycles.png", "demo.exr", "cycles.exr", "demo.blend"):
        print(f"wrote {output / name}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
