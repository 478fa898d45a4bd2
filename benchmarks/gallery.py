# SPDX-License-Identifier: GPL-3.0-or-later
"""`python -m benchmarks gallery`: contact sheets, ours beside Cycles' and the difference, to be looked at."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.images import Float32Array, auto_exposure, signed_difference, tone_map
from benchmarks.rendering import render_scene
from benchmarks.rivals import Budget, Rival, find_rival
from benchmarks.scene_files import SceneSource

#: Relative difference at which the colour of the difference saturates.
DIFFERENCE_SCALE = 0.25
MARGIN, TITLE_HEIGHT = 8, 20
#: Size scenes from files are rendered at where none is asked for [pixels].
FILE_PIXELS = 97_200
GROUP_COLUMNS = 2


def _enlarged(pixels: np.ndarray, width: int) -> np.ndarray:
    factor = max(width // pixels.shape[1], 1)
    return np.repeat(np.repeat(pixels, factor, axis=0), factor, axis=1)


def strip(title: str, ours: Float32Array, theirs: Float32Array, panel_width: int) -> Any:
    """Ours, Cycles' and the difference side by side under a title; a PIL image.

    Both pictures get one exposure (from Cycles') and the sRGB curve; the difference is red where ours is brighter.
    """
    from PIL import Image, ImageDraw

    exposure = auto_exposure(theirs)
    panels = [
        _enlarged(panel, panel_width)
        for panel in (
            tone_map(ours, exposure),
            tone_map(theirs, exposure),
            signed_difference(ours, theirs, DIFFERENCE_SCALE),
        )
    ]
    height, width = panels[0].shape[:2]
    sheet = Image.new("RGB", (3 * width + 4 * MARGIN, height + TITLE_HEIGHT + MARGIN), (24, 24, 24))
    ImageDraw.Draw(sheet).text((MARGIN, 4), title, fill=(230, 230, 230))
    for index, panel in enumerate(panels):
        sheet.paste(Image.fromarray(panel), (MARGIN + index * (width + MARGIN), TITLE_HEIGHT))
    return sheet


def stack(strips: Sequence[Any], columns: int) -> Any:
    """Strips of any size in columns, left to right and then down."""
    from PIL import Image

    width = max(strip.width for strip in strips)
    rows = [strips[i : i + columns] for i in range(0, len(strips), columns)]
    heights = [max(strip.height for strip in row) for row in rows]
    sheet = Image.new("RGB", (width * min(columns, len(strips)), sum(heights)), (24, 24, 24))
    y = 0
    for row, height in zip(rows, heights, strict=True):
        for column, item in enumerate(row):
            sheet.paste(item, (column * width, y))
        y += height
    return sheet


def _title(source: SceneSource, samples: int) -> str:
    scale = f"{100 * DIFFERENCE_SCALE:.0f}%"
    return f"{source.name}: NeuralGuide, Cycles, difference (red: brighter, full colour {scale}), {samples} spp"


def gallery(
    sources: Sequence[SceneSource],
    rival: Rival,
    samples: int,
    *,
    out: Path,
    pixels: int = 0,
    threads: int = 0,
    resume: bool = False,
) -> int:
    """Write one sheet a file scene, one a group of built-in scenes; returns the number of failures."""
    out.mkdir(parents=True, exist_ok=True)
    cache = Path("out") / "gallery"
    groups: dict[str, list[Any]] = {}
    failure_count = 0
    for source in sources:
        size = pixels or (0 if source.is_builtin else FILE_PIXELS)
        rivals = [find_rival("cycles"), rival]
        renders, failures = render_scene(
            source, rivals, Budget(samples), 1, out=cache, pixels=size, threads=threads, resume=resume
        )
        failure_count += len(failures)
        if failures:
            continue
        ours, theirs = renders[rival.name][0].image, renders["cycles"][0].image
        if ours.shape != theirs.shape:
            print(f"  {source.name}: sizes differ, {ours.shape} for {theirs.shape}")
            failure_count += 1
            continue
        if source.is_builtin:
            from benchmarks.scenes import SCENES

            title = source.name
            groups.setdefault(SCENES[source.name].group, []).append(strip(title, ours, theirs, 192))
        else:
            strip(_title(source, samples), ours, theirs, 360).save(out / f"{source.name}.png", optimize=True)
            print(f"  wrote {out / source.name}.png")
    for group, strips in groups.items():
        stack(strips, GROUP_COLUMNS).save(out / f"builtin_{group}.png", optimize=True)
        print(f"  wrote {out}/builtin_{group}.png")
    return failure_count
