# SPDX-License-Identifier: GPL-3.0-or-later
"""Records of renders that never were, with errors that can be written down by hand."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.environment import describe
from benchmarks.images import write_exr
from benchmarks.reference import ReferenceFacts
from benchmarks.rendering import RenderRecord

WIDTH, HEIGHT = 48, 32
LIGHT_PATHS = {"max_bounces": 8, "clamp_direct": 0.0}


def grey(value: float = 1.0) -> np.ndarray:
    """An image of one value, alpha 1."""
    image = np.full((HEIGHT, WIDTH, 4), value, np.float32)
    image[..., 3] = 1.0
    return image


def write_render(
    folder: Path, rival: str, seed: int, image: np.ndarray, *, scene: str = "room", seconds: float = 0.0,
    samples: int = 0, **facts: Any,
) -> None:  # fmt: skip
    """One render: `seconds` is asked for and taken, or else `samples` are asked for."""
    taken = facts.pop("render_seconds", seconds)
    rendered = facts.pop("rendered", float(samples))
    record = RenderRecord(
        scene, "hash", rival, seed, WIDTH, HEIGHT, 0 if seconds else samples, seconds, 2, render_seconds=taken,
        samples=rendered, peak_memory_mib=100.0, environment=describe(), light_paths=LIGHT_PATHS,
        date="2026-01-01T00:00:00+00:00", **facts,
    )  # fmt: skip
    budget = f"{seconds:g}s" if seconds else f"{samples}spp"
    path = folder / budget / scene / f"{rival}_{budget}_seed{seed}.exr"
    write_exr(path, image)
    path.with_suffix(".json").write_text(json.dumps(asdict(record)), encoding="utf-8")


def write_line(
    folder: Path, rival: str, steps: dict[float, float], image: Callable[[float, int], np.ndarray], **facts: Any
) -> None:
    """Three seeds under time budgets: {seconds: error}, pictures made by `image(error, seed)`; 10 samples a second."""
    for seconds, error in steps.items():
        for seed in (1, 2, 3):
            write_render(
                folder, rival, seed, image(error, seed), seconds=seconds, rendered=10.0 * seconds, **facts
            )


def write_reference(folder: Path, image: np.ndarray, *, scene: str = "room", **facts: Any) -> None:
    """A reference with its JSON."""
    known = {
        "scene": scene, "scene_hash": "hash", "light_paths": LIGHT_PATHS, "width": WIDTH, "height": HEIGHT,
        "rival": "cycles", "samples": 1024, "seeds": [1, 2], "error": 1e-6, "error_trimmed": 1e-6,
    }  # fmt: skip
    write_exr(folder / f"{scene}.exr", image)
    stored = asdict(ReferenceFacts(**{**known, **facts}))
    (folder / f"{scene}.json").write_text(json.dumps(stored), encoding="utf-8")
