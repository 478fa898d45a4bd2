# SPDX-License-Identifier: GPL-3.0-or-later
"""The picture again, from passes of light taken apart."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

LOBES = ("Diffuse", "Glossy", "Transmission")


def lit_by(images: Mapping[str, np.ndarray], lobes: str, light: str) -> np.ndarray:
    """What lobes of a kind send of direct or indirect light, colour multiplied in again; float32 (height, width, 3)."""
    return images[f"{lobes} Color"][..., :3] * images[f"{lobes} {light}"][..., :3]


def sum_of_passes(images: Mapping[str, np.ndarray]) -> np.ndarray:
    """Emission + Environment + sum over lobes of Color x (Direct + Indirect), as users put it together.

    With light that volumes have scattered, where `images` has its passes.
    """
    plain = ("Emission", "Environment", "Volume Direct", "Volume Indirect")
    return sum(images[name][..., :3] for name in plain if name in images) + (
        sum(lit_by(images, lobes, light) for lobes in LOBES for light in ("Direct", "Indirect"))
    )
