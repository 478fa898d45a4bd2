# SPDX-License-Identifier: GPL-3.0-or-later
"""Kinds of radiance cache, a record each: whether paths end early with learned light, and who measures what it lacks.

This module imports nothing: Blender's menus are made of it when the add-on is enabled.
"""

from __future__ import annotations

from typing import NamedTuple


class Accuracy(NamedTuple):
    """A kind of radiance cache: its name in settings and scripts, and label and sentence for menus."""

    name: str
    label: str
    sentence: str


#: Files hold their places: new ones go last.
ACCURACIES = (
    Accuracy(
        "OFF", "Unbiased",
        "Paths find all light themselves: right on average from the first sample on, with more noise in rooms",
    ),
    Accuracy("FAST", "Fast", "Biased: what was not learned is left out. For previews"),
    Accuracy(
        "CONVERGING", "Converging",
        "Some paths go on and measure what the learned light lacks: the image gets as right as one wants",
    ),
    Accuracy(
        "AUTO", "Automatic",
        "Converging in renders that are not denoised and scenes that can have it, until it is found not to pay; else "
        "Unbiased",
    ),
)
#: Of them, those where some paths measure what the cache lacks.
MEASURED = frozenset({"CONVERGING", "AUTO"})
#: Samples a pixel from which on `AUTO` has a cache: of fewer, none are left once it is judged.
LEAST_CACHED_SAMPLES = 16
