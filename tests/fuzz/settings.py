# SPDX-License-Identifier: GPL-3.0-or-later
"""Random settings that both renderers know, and a method of ours."""

from __future__ import annotations

from random import Random
from typing import Any

from engine.methods import METHODS, SOURCES
from tests.fuzz.numbers import chance

#: Methods without a process that trains a network, which takes longer than a scene of the fuzzer.
METHOD_NAMES = tuple(
    name for name, method in METHODS.items()
    if method.predictor != "NETWORK" and not (method.source and SOURCES[method.source].is_network)
)  # fmt: skip


def choose_settings(random: Random, scene: Any) -> None:
    """Bounces, clamps, film, light tree, roulette, method, radiance cache."""
    cycles, ours, render = scene.cycles, scene.neuralguide, scene.render
    for name, values in (
        ("max_bounces", (12, 12, 12, 4, 1, 0)),
        ("diffuse_bounces", (4, 4, 4, 1, 0)),
        ("glossy_bounces", (4, 4, 4, 1, 0)),
        ("transmission_bounces", (12, 12, 12, 2, 0)),
        ("volume_bounces", (0, 0, 2)),
        ("transparent_max_bounces", (8, 8, 8, 2, 1, 0)),
        ("min_light_bounces", (0, 0, 0, 2)),
        ("min_transparent_bounces", (0, 0, 0, 2)),
        ("blur_glossy", (0.0, 1.0, 1.0, 10.0)),
        ("sample_clamp_direct", (0.0,) * 9 + (10.0,)),
        ("sample_clamp_indirect", (0.0, 0.0, 0.0, 10.0)),
        ("caustics_reflective", (True, True, True, False)),
        ("caustics_refractive", (True, True, True, False)),
        ("use_light_tree", (True, True, False)),
        ("light_sampling_threshold", (0.0, 0.01)),
        ("pixel_filter_type", ("BOX", "GAUSSIAN", "BLACKMAN_HARRIS", "BLACKMAN_HARRIS")),
        ("filter_width", (1.5, 1.5, 0.01, 4.0)),
        ("film_exposure", (1.0, 1.0, 1.0, 0.5, 4.0)),
    ):
        setattr(cycles, name, random.choice(values))
    cycles.volume_biased = False
    cycles.use_adaptive_sampling = cycles.use_denoising = False
    render.film_transparent = chance(random, 0.2)
    ours.guiding_method = random.choice((*METHOD_NAMES, "AUTO", "OFF", "OFF"))
    ours.radiance_cache = random.choice(("OFF", "OFF", "OFF", "OFF", "CONVERGING"))
    experiment = ours.experiment
    experiment.roulette = random.choice(("AUTO", "AUTO", "AUTO", "THROUGHPUT", "LEARNED"))
    ours.light_selection = random.choice(("AUTO", "AUTO", "AUTO", "TREE", "LEARNED"))
    ours.spectral = "ON" if chance(random, 0.05) else "OFF"
    ours.guiding_trial = chance(random, 0.5)
