# SPDX-License-Identifier: GPL-3.0-or-later
"""What is wrong with our picture of a random scene, beside that of Cycles."""

from __future__ import annotations

import time
import warnings
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from addon import engine
from tests.helpers.fuzz.scenes import make_scene
from tests.helpers.pass_scenes import render_passes

#: Samples of a first look, and of further ones where it is not sure.
_LOOKS = (16, 256, 4096)
#: Means may differ by this factor; cells by more, of which each has a twelfth of the pixels.
_MEANS, _CELLS = 1.3, 2.0
#: What is darker than this share of the brightest cell, or of one, is not compared.
_DARK = 0.02
#: Cells of a picture that is darker altogether differ by less than a screen shows.
_SHOWN = 2.5e-2
#: Pixels count up to so many times the median of Cycles' picture: single bright ones decide nothing.
_CAP = 12.0
#: A scene of 192 pixels takes no longer, by processor time and without what is compiled [s].
_PATIENCE = 60.0


@dataclass
class Verdict:
    """On one scene.

    problems : list of str, empty where all is well
    notices : list of str, what the engine has said of the scene; its picture is not compared then
    """

    seed: int
    problems: list[str] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)
    ours: np.ndarray | None = None
    theirs: np.ndarray | None = None


def judge(seed: int, folder: Path, *, is_explained: bool = False) -> Verdict:
    """Render the scene of a seed by ours and by Cycles, with more samples where few leave a doubt not yet explained."""
    verdict = Verdict(seed)
    scene = make_scene(seed)
    for samples in _LOOKS[:1] if is_explained else _LOOKS:
        verdict.problems = []
        begin = time.process_time()
        with warnings.catch_warnings(record=True) as warned:
            warnings.simplefilter("always")
            verdict.ours = _render(scene, "NEURALGUIDE", samples, folder)
        spent = time.process_time() - begin
        verdict.problems += [f"warning: {item.message}" for item in warned if issubclass(item.category, RuntimeWarning)]
        (outcome,) = list(engine.outcomes)[-1:]
        if outcome.status != "FINISHED":
            verdict.problems.append(f"{outcome.status}: {outcome.message}")
            return verdict
        spent -= outcome.report.compile_seconds
        if spent > _PATIENCE:
            verdict.problems.append(f"took {spent:.0f} s with {samples} samples")
        if not np.isfinite(verdict.ours).all():
            verdict.problems.append("the picture is not finite")
        verdict.notices = [f"{item.subject}: {item.problem}" for item in outcome.report.notices]
        if verdict.problems or verdict.notices:
            return verdict
        verdict.theirs = _render(scene, "CYCLES", samples, folder)
        verdict.problems = _differences(verdict.ours, verdict.theirs)
        if not verdict.problems:
            break
    return verdict


def _render(scene: Any, kind: str, samples: int, folder: Path) -> np.ndarray:
    """Float64 (12, 16, 4)."""
    scene.render.engine = kind
    scene.neuralguide.samples = scene.cycles.samples = samples
    # So few of Cycles' paths find caustics that its picture has none.
    scene.neuralguide.caustics = "PATHS"
    scene.cycles.use_adaptive_sampling = scene.cycles.use_denoising = False
    scene.cycles.pixel_filter_type = "BOX"
    images, _ = render_passes(scene, folder / f"{kind}.exr")
    return np.stack([next(images[name] for name in images if name.endswith(f"Combined.{part}")) for part in "RGBA"], -1)


def _differences(ours: np.ndarray, theirs: np.ndarray) -> list[str]:
    found = []
    # Light below zero has no meaning that both could agree on: what the radiance cache keeps of it is black.
    if not np.isfinite(theirs).all() or min(theirs.min(), ours.min()) < -_DARK:
        return found
    cap = _CAP * max(float(np.median(np.abs(theirs[..., :3]).max(axis=-1))), 1e-3)
    cells = [np.clip(image, -cap, cap).reshape(3, 4, 4, 4, 4).mean(axis=(1, 3)) for image in (ours, theirs)]
    floor = _DARK * max(float(np.abs(cells[0]).max()), float(np.abs(cells[1]).max()), _SHOWN)
    means = [image.mean(axis=(0, 1)) for image in cells]
    for name, one, other in zip("RGBA", *means, strict=True):
        if not _is_within(one, other, _MEANS, floor):
            found.append(f"mean {name}: {one:.4g} for {other:.4g}")
    off = sum(
        not _is_within(one, other, _CELLS, 2.0 * floor) for one, other in zip(*map(np.ravel, cells), strict=True)
    )
    return found + ([f"{off} of {cells[0].size} cells differ"] if off > 1 else [])


def _is_within(one: float, other: float, factor: float, floor: float) -> bool:
    low, high = sorted((abs(one), abs(other)))
    return abs(one - other) <= floor or (one * other > 0.0 and high <= factor * low)
