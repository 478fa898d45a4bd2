# SPDX-License-Identifier: GPL-3.0-or-later
"""Saves a pass as a picture for the screen, and says how noisy a render is."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from PIL import Image


def save_picture(image: np.ndarray, path: Path) -> None:
    """Save a pass as PNG: float32 (height, width, 3 or more), linear, row 0 at the bottom."""
    linear = np.clip(image[::-1, :, :3], 0.0, 1.0)
    curved = np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1.0 / 2.4) - 0.055)
    path.parent.mkdir(parents=True, exist_ok=True)
    Image.fromarray((255.0 * curved + 0.5).astype(np.uint8)).save(path)
    print(f"wrote {path}")


def noise(passes: Mapping[str, np.ndarray]) -> float:
    """Noise of a render that has the pass Variance: the standard error of its pixels over their mean."""
    return float(np.sqrt(passes["Variance"].mean()) / passes["Combined"][..., :3].mean())
