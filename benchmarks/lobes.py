# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks.lobes scene.blend --pixel X Y`: what guiding methods have learned there, beside the truth.

As Dong et al. 2023 (NPM), Fig. 11, and Huang et al. 2024 (NASG), Fig. 7, compare them: by picture and by KL divergence.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import environment
from benchmarks.lobe_maps import FLOOR, Comparison, compare
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import expand, open_scene
from engine.methods import SOURCES

#: Size of a render where none is asked for [pixels].
_PIXELS = 37_000
#: Decades of the colour scale, from the truth's largest density down.
_DECADES = 4
_COLUMNS = 3


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="python -m benchmarks.lobes", description="What guiding methods have learned at a point, beside the truth."
    )
    parser.add_argument("scene", help=".blend file or builtin:NAME")
    parser.add_argument(
        "--pixel", nargs=2, type=int, required=True, metavar=("X", "Y"),
        help="of the image as --size has it, from its top left",
    )
    parser.add_argument("--methods", nargs="+", default=list(SOURCES), choices=SOURCES, help="default: all")
    parser.add_argument("--samples", type=int, default=63, help="a pixel, to learn in (default: %(default)s)")
    parser.add_argument(
        "--size", nargs=2, type=int, metavar=("WIDTH", "HEIGHT"),
        help=f"of the image to learn in (default: about {_PIXELS} pixels)",
    )
    parser.add_argument("--rows", type=int, default=64, help="of the maps, half their columns (default: %(default)s)")
    parser.add_argument("--truth-samples", type=int, default=1024, help="a direction (default: %(default)s)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--threads", type=int, default=0, help="0 = all cores")
    parser.add_argument("--nee", action="store_true", help="sample lights, so that methods learn what that leaves over")
    parser.add_argument(
        "--deterministic", action=argparse.BooleanOptionalAction, default=True,
        help="train networks for a fixed number of steps, so that results repeat",
    )
    parser.add_argument(
        "--output", type=Path, default=Path("out/lobes.png"), help="picture; figures go to .json (default: %(default)s)"
    )
    return parser


def draw(comparison: Comparison, title: str, path: Path) -> None:
    """Write a grid of maps in false colours on one logarithmic scale; a cross marks the surface's normal."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.colors import LogNorm
    from matplotlib.figure import Figure

    panels: list[tuple[str, np.ndarray]] = [
        (f"truth, {name.lower()}\n(KL between halves {comparison.noise[name]:.3f})", density)
        for name, density in comparison.truths.items()
    ]
    for learned in comparison.methods:
        own = learned.divergence[learned.target]
        other = "RADIANCE" if learned.target == "PRODUCT" else "PRODUCT"
        text = f"KL {own:.3f} from {learned.target.lower()} ({learned.divergence[other]:.3f} from {other.lower()})"
        panels.append((f"{learned.method}\n{text if learned.integral else 'not guided here'}", learned.density))
    largest = max(float(density.max()) for density in comparison.truths.values())
    scale = LogNorm(largest / 10.0**_DECADES, largest, clip=True)
    row_count = -(-len(panels) // _COLUMNS)
    figure = Figure(figsize=(4.2 * _COLUMNS, 2.4 * row_count + 0.6), dpi=80, layout="constrained")
    FigureCanvasAgg(figure)
    axes = figure.subplots(row_count, _COLUMNS, squeeze=False)
    n = comparison.surface.normal
    azimuth, height = np.degrees(np.arctan2(n[0], n[1])), np.degrees(np.arcsin(np.clip(n[2], -1.0, 1.0)))
    shown: Any = None
    for axis in axes.flat:
        axis.set_axis_off()
    for axis, (text, density) in zip(axes.flat, panels):
        axis.set_axis_on()
        shown = axis.imshow(
            np.maximum(density, 1e-30), origin="lower", extent=(-180, 180, -90, 90), cmap="inferno", norm=scale,
            interpolation="nearest",
        )
        axis.plot(azimuth, height, "+", color="cyan", markersize=8)
        axis.set_title(text, fontsize=9)
        axis.set_xticks([-180, -90, 0, 90, 180], ["-y", "-x", "+y", "+x", "-y"], fontsize=7)
        axis.set_yticks([-90, 0, 90], ["-z", "", "+z"], fontsize=7)
    figure.colorbar(shown, ax=axes, label="density [1/sr]", shrink=0.8)
    figure.suptitle(title, fontsize=11)
    path.parent.mkdir(parents=True, exist_ok=True)
    figure.savefig(path)


def _record(comparison: Comparison, facts: dict[str, Any]) -> dict[str, Any]:
    """Figures of a comparison, as they go into its JSON file."""
    surface = comparison.surface
    return {
        **facts,
        "floor": FLOOR,
        "position": surface.position.tolist(),
        "normal": surface.normal.tolist(),
        "is_diffuse": surface.is_diffuse,
        "noise": comparison.noise,
        "methods": {
            learned.method: {
                "target": learned.target,
                "divergence": {
                    name: value if math.isfinite(value) else None for name, value in learned.divergence.items()
                },
                "integral": learned.integral,
                "status": learned.status,
            }
            for learned in comparison.methods
        },
        "notices": comparison.notices,
        "environment": environment.describe(),
    }


def main(arguments: list[str] | None = None) -> int:
    """Compare, write picture and figures; returns the exit status."""
    chosen = _parser().parse_args(arguments)
    try:
        import bpy

        from addon.export import export_scene
        from addon.properties import render_settings

        sources = expand([chosen.scene])
        if len(sources) != 1:
            raise ValueError(f"{chosen.scene} names {len(sources)} scenes: choose one")
        scene = open_scene(sources[0], _PIXELS, tuple(chosen.size) if chosen.size else None)
        find_rival("OFF").configure(scene, Budget(chosen.samples), chosen.seed, chosen.threads)
        # What is drawn knows colours, not wavelengths.
        settings = replace(
            render_settings(scene), use_nee=chosen.nee, deterministic=chosen.deterministic, spectral="OFF"
        )
        description = export_scene(bpy.context.evaluated_depsgraph_get())
        x, y = chosen.pixel
        width, height = description.frame.width, description.frame.height
        comparison = compare(
            description, settings, (x, height - 1 - y), chosen.methods, rows=chosen.rows,
            truth_samples=chosen.truth_samples,
        )
    except ValueError as error:
        print(f"error: {error}", file=sys.stderr)
        return 2
    facts = {
        "scene": sources[0].name, "scene_hash": sources[0].content_hash(), "pixel": [x, y], "width": width,
        "height": height, "samples": chosen.samples, "truth_samples": chosen.truth_samples, "rows": chosen.rows,
        "nee": chosen.nee, "deterministic": chosen.deterministic, "seed": chosen.seed,
    }
    lights = "what light sampling leaves over" if chosen.nee else "no light sampling"
    title = f"{sources[0].name}, pixel {x} {y} of {width} x {height}, {chosen.samples} samples a pixel, {lights}"
    draw(comparison, title, chosen.output)
    figures = chosen.output.with_suffix(".json")
    figures.write_text(json.dumps(_record(comparison, facts), indent=1) + "\n", encoding="utf-8")
    for notice in comparison.notices:
        print(f"  {notice}")
    for learned in comparison.methods:
        values = ", ".join(f"{value:.3f} from {name.lower()}" for name, value in learned.divergence.items())
        found = f"KL {values}; aims at {learned.target.lower()}; integral {learned.integral:.3f}"
        print(f"  {learned.method:16} {found if learned.integral else 'not guided here'}")
    print(f"  wrote {chosen.output} and {figures}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
