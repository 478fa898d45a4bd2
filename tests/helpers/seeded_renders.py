# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders of small scenes by seed, and whether their means agree."""

from __future__ import annotations

import numpy as np

from engine.guiding.policy.rules import RULES, Rules
from engine.render.session import Session
from engine.settings import RenderSettings
from tests.helpers.small_scenes import corner_scene

#: Standard errors: a family of three methods fails by chance once in about 5000 choices of seeds.
Z_LIMIT = 4.0
SEEDS = 4


def render(
    method, seed, *, scene=corner_scene, passes=("Combined",), samples=15, max_bounces=6, rules=RULES, **settings
):
    """Result of one render of `scene()` by a guiding method."""
    session = Session(
        RenderSettings(samples=samples, seed=seed, guiding_method=method, max_bounces=max_bounces, **settings),
        rules=rules,
    )
    session.load(scene())
    result = session.render(passes=passes)
    session.close()
    return result


def z_score(a, b):
    """Difference of means in its standard errors."""
    error = np.sqrt(a.var(ddof=1) / len(a) + b.var(ddof=1) / len(b))
    return abs(a.mean() - b.mean()) / error


def trial_rules(least, clear=None, **others):
    """Rules by which guiding goes on if it has this efficiency, and needs no more comparing with that one."""
    rules = {"least_efficiency": dict.fromkeys(RULES.least_efficiency, least), "least_of_short": least}
    if clear is not None:
        rules["clear_efficiency"] = dict.fromkeys(RULES.clear_efficiency, clear)
    return Rules(**{**rules, **others})


def render_seeds(description, seeds, rules=RULES, **settings):
    """Images float32 (height, width, 3), one a seed."""
    images = []
    for seed in seeds:
        session = Session(RenderSettings(**{"samples": 64, "threads": 1, "seed": seed, **settings}), rules=rules)
        session.load(description)
        images.append(session.render().passes["Combined"][..., :3])
        session.close()
    return images
