# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of media, and whether their means are what they should be."""

from __future__ import annotations

import numpy as np
from scipy import stats

from engine.render.session import Session
from engine.settings import RenderSettings

SIGMAS = 4.0
SIGNIFICANCE = 1e-3


def render(description, passes=("Combined",), **settings):
    defaults = {"samples": 4, "threads": 1, "guiding_method": "OFF", "filter_glossy": 0.0}
    session = Session(RenderSettings(**{**defaults, **settings}))
    session.load(description)
    result = session.render(passes=passes)
    session.close()
    assert result.report.reject_count == 0
    return result


def picture(description, **settings):
    return render(description, **settings).passes["Combined"][..., :3]


def means_by_seed(description, seeds=8, **settings):
    """Mean of each render, float64 (seeds, 3)."""
    images = [picture(description, seed=seed, **settings) for seed in range(seeds)]
    return np.array([image.mean(axis=(0, 1), dtype=np.float64) for image in images])


def is_mean(means, expected):
    """Whether means by seed agree with an expected value, float (3,); one right renderer in 1,000 fails."""
    error = means.std(axis=0, ddof=1) / np.sqrt(len(means))
    # Of few seeds the error itself is uncertain (Student, 1908).
    errors = stats.t.isf(0.5 * SIGNIFICANCE, len(means) - 1)
    return bool((np.abs(means.mean(axis=0) - expected) <= errors * error + 1e-5).all())
