# SPDX-License-Identifier: GPL-3.0-or-later
"""How the paths of an arm go, as far as the render's questions have been answered."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

#: What is guided, in words for people.
BOTH, SURFACES, MEDIA = "surfaces and media", "surfaces alone", "media alone"


@dataclass(frozen=True)
class Way:
    """How the paths of an arm go.

    is_guided : bool
    rung : str, the method (`engine.methods.METHODS`)
    probes_only : bool, whether resampling is only tried, at some vertices of recorded paths
    guides : str, one of BOTH, SURFACES and MEDIA
    ends_by_learned : bool, whether roulette goes by what was learned
    uses_cache : bool, whether paths end in the radiance cache
    measured_share : float, of these paths: so many go on all the same, and measure what the cache lacks
    """

    is_guided: bool = False
    rung: str = ""
    probes_only: bool = False
    guides: str = BOTH
    ends_by_learned: bool = True
    uses_cache: bool = False
    measured_share: float = 0.0


@dataclass(frozen=True)
class ImageState:
    """What is known of the image so far.

    weights : float32 (P,) or None, of the pixels' variances (`engine.ris.orca.pixel_weights`); None: nothing is known
    variance : float, of a guided sample of a pixel, relative (`engine.ris.orca.image_variance`)
    ray_count : float, cost of a path [rays]
    brightness : float, mean of the image
    """

    weights: np.ndarray | None = None
    variance: float = 0.0
    ray_count: float = 0.0
    brightness: float = 0.0
