# SPDX-License-Identifier: GPL-3.0-or-later
"""Whatever guides, light of every part of the shutter and of the spectrum has the mean of unguided rendering.

A bias of one part may hide in the mean of all. So the film keeps eight parts of the shutter apart, or eight parts of
the density that wavelengths are drawn from, and each is compared with unguided renders of other seeds by a Z-test:
relative difference of the picture's mean over its standard error, from the pixels' variances over seeds. A family of
eight fails for an unbiased method with a chance of `SIGNIFICANCE` (two-sided, Bonferroni, normal noise; seeds are
fixed). Each time 2% are planted in every part in turn, more and less, and found.

Nothing in the engine knows of this: what is kept apart are the strata of renders in strata, here with one pass over all
of them, and wavelengths by other weights of the film's three channels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from functools import cache
from itertools import product
from statistics import NormalDist
from typing import Any

import numpy as np
import pytest

from benchmarks import metrics
from engine.guiding.models.regions import RegionModels
from engine.guiding.policy import sets
from engine.guiding.records.vertices import VertexRecords
from engine.render import request, resolution, tracer
from engine.render.session import Session
from engine.render.strata import StrataFilm, StrataSchedule
from engine.scene.description import VISIBLE_CAMERA, SceneDescription
from engine.scene.instances import plain_instances
from engine.settings import RenderSettings
from engine.spectral.wavelengths import CELL_COUNT
from engine.state.unit import ALL_STRATA
from tests.helpers.placed_quads import steps, turned
from tests.helpers.small_scenes import emitter_scene
from tests.helpers.small_scenes import material as plain_material
from tests.helpers.some_cases import every
from tests.helpers.spectral_scenes import DISPERSION, IOR, diffuse, glass, material, scene, square, wedge
from tests.helpers.untrained_networks import BadNetwork, Untrained, ask

PARTS = 8
SIGNIFICANCE = 1e-4
LIMIT = NormalDist().inv_cdf(1.0 - SIGNIFICANCE / (2.0 * PARTS))
PLANTED = 0.02
REFERENCE_SEEDS = range(100, 104)

Images = list[np.ndarray]


# ---------------------------------------------------------------------------------------------------------------------
# The test


def scores(images: Images, references: Images) -> np.ndarray:
    """Difference of the means of each part in standard errors; pictures are float (PARTS, height, width)."""
    found = []
    for part in range(PARTS):
        difference, error = metrics.compare_means(
            [image[part][..., None] for image in images], [image[part][..., None] for image in references]
        )
        found.append(float(np.abs(difference[0]) / error[0]))
    return np.array(found)


def check(images: Images, references: Images) -> None:
    """No part is biased, and 2% of any would have been found."""
    assert all(np.isfinite(image).all() for image in images)
    found = scores(images, references)
    with_bias = []
    for part, factor in product(range(PARTS), (1.0 + PLANTED, 1.0 - PLANTED)):
        planted = [image * np.where(np.arange(PARTS) == part, factor, 1.0)[:, None, None] for image in images]
        with_bias.append(scores(planted, references)[part])
    print(f"standard errors {found.round(1)}, with 2% planted {np.round(min(with_bias), 1)}, limit {LIMIT:.1f}")
    assert (found < LIMIT).all() and min(with_bias) > LIMIT


def wrong_field(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have mixture fields learn something else than what paths have found."""
    fit = RegionModels.fit
    random = np.random.default_rng(1)

    def fit_wrongly(regions: RegionModels, records: VertexRecords, row_count: int, *threads: Any) -> None:
        radiance, direction = records.radiance.copy(), records.direction.copy()
        if kind == "random":
            radiance[:row_count] = 10.0 ** random.uniform(-2.0, 2.0, radiance[:row_count].shape)
            direction[:row_count] = random.permutation(direction[:row_count])
        elif kind == "inverted":
            radiance[:row_count] = 1.0 / np.maximum(radiance[:row_count], 1e-3)
        else:
            radiance[:row_count:2] = np.nan
        fit(regions, records._replace(radiance=radiance, direction=direction), row_count, *threads)

    monkeypatch.setattr(RegionModels, "fit", fit_wrongly)


METHODS: dict[str, dict[str, Any]] = {
    "VMM": {"guiding_method": "VMM"},
    "NPM": {"guiding_method": "NPM", "mixture_u": "PLANES"},
    "NEURAL_RIS": {"guiding_method": "NEURAL_RIS", "candidate_allocation": "FIXED", "candidate_count": 3},
}


def mislead(method: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Have a method go by what is wrong in the way `kind`."""
    if method == "VMM":
        wrong_field(kind, monkeypatch)
    elif method == "NEURAL_RIS":
        ask(BadNetwork(kind), monkeypatch)
    else:
        assert kind == "random"
        monkeypatch.setattr(sets, "make_source_model", lambda settings: Untrained(settings, 4.0))


def guided(method: str) -> dict[str, Any]:
    """Settings of a render that is guided wherever it can be."""
    forced = {"guiding_trial": False, "learn_guiding_probability": False, "guiding_probability": 0.5}
    return METHODS[method] | forced


def seeds_of(method: str) -> range:
    """Seeds that no other method has, lest they all share the luck of the camera's samples."""
    first = 10 * (1 + list(METHODS).index(method))
    return range(first, first + 3)


# ---------------------------------------------------------------------------------------------------------------------
# Time


def moving_ceiling() -> SceneDescription:
    """A pit under a glowing square, which turns and flies across it and grows, and which the camera sees through.

    Without light sampling all light comes by directions that are guided to.
    """
    description = emitter_scene()
    walls = [turned(s * np.pi / 2, 1, (3.0 * s, 0.0, 0.0)) for s in (-1, 1)]
    walls += [turned(s * np.pi / 2, 0, (0.0, -3.0 * s, 0.0)) for s in (-1, 1)]
    glow = steps(
        *(turned(np.pi + 0.4 * t, 0, (1.5 * t, 0.3, 2.5 + 0.3 * t), (2.0, 2.0, 1.0)) for t in (-1.0, 0.0, 1.0))
    )
    transforms = np.stack([np.eye(4), *walls, glow[1]]).astype(np.float32)
    instances = plain_instances(transforms, meshes=[0] * 5 + [1], materials=[0] * 5 + [1])
    instances.motion = {5: glow}
    instances.visibility[5] &= ~np.uint32(VISIBLE_CAMERA)
    white = plain_material(color=(0.8, 0.7, 0.6))
    return replace(description, instances=instances, materials=[white, description.materials[1]])


def strata_means(seeds: Sequence[int], monkeypatch: pytest.MonkeyPatch, samples: int, **settings: Any) -> Images:
    """Means over the channels by stratum, pixel and seed, of renders that keep strata apart."""
    films: list[StrataFilm] = []

    class KeptFilm(StrataFilm):
        def __init__(self, *arguments: Any, **options: Any) -> None:
            super().__init__(*arguments, **options)
            films.append(self)

    monkeypatch.setattr(request, "StrataFilm", KeptFilm)
    if "strata" not in settings:
        is_guided = "guiding_method" in settings

        def following(schedule: StrataSchedule, sample: int, seconds: float) -> tuple[int, int] | None:
            left = samples - sample
            return (ALL_STRATA, min(left, sample + 1, 256) if is_guided else left) if left else None

        monkeypatch.setattr(resolution, "strata_count", lambda *_: PARTS)
        monkeypatch.setattr(StrataSchedule, "next", following)
    images = []
    for seed in seeds:
        job = Session(RenderSettings(**{
            "samples": samples, "seed": seed, "threads": 2, "max_bounces": 1, "use_nee": False, **settings
        }))  # fmt: skip
        job.load(moving_ceiling())
        result = job.render()
        job.close()
        assert result.report.reject_count == 0
        sums = films[-1].by_stratum.sums
        shape = (PARTS, films[-1].height, films[-1].width)
        assert (sums.weight > 0.0).all()
        images.append((sums.radiance.mean(axis=1) / sums.weight).reshape(shape).astype(np.float64))
    return images


@cache
def strata_reference() -> tuple[np.ndarray, ...]:
    with pytest.MonkeyPatch.context() as patch:
        return tuple(strata_means(REFERENCE_SEEDS, patch, 12288))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "kind", "settings"),
    every(
        [
            ("VMM", "inverted", {"samples": 10240}),
            ("NPM", "random", {"samples": 6144}),
            ("VMM", "random", {"use_nee": True, "samples": 2048}),
            ("VMM", "NaN", {}),
            ("NPM", "random", {"strata": PARTS}),
            ("NEURAL_RIS", "random", {}),
            ("NEURAL_RIS", "inverted", {"use_nee": True, "samples": 2048}),
        ],
        2,
    ),
)
def test_every_stratum_of_time_has_its_mean(
    method: str, kind: str, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    mislead(method, kind, monkeypatch)
    settings = {"samples": 5120} | guided(method) | settings
    check(strata_means(seeds_of(method), monkeypatch, **settings), list(strata_reference()))


# ---------------------------------------------------------------------------------------------------------------------
# Wavelengths


def coloured_glass() -> SceneDescription:
    """A coloured floor with a piece of strongly dispersive glass on it, and a warm ceiling."""
    corners, triangles = wedge()
    glow = material("Emission", Color=(1.0, 0.7, 0.4, 1.0), Strength=2.0)
    description = scene(
        [
            ((0.3 * corners, triangles), glass(IOR, 0.5, DISPERSION)),
            (square(9.0, 0.0), diffuse((0.3, 0.6, 0.8))),
            (square(9.0, 7.0, 3.0), glow),
        ],
        size=(16, 12),
    )
    description.instances.visibility[2] &= ~np.uint32(VISIBLE_CAMERA)
    return description


def band_weights(first: int) -> np.ndarray:
    """What the film's channels get of radiance by u, float32 (CELL_COUNT + 1, 3): of three bands from `first` on."""
    nodes = np.arange(CELL_COUNT + 1) * PARTS // CELL_COUNT
    bands = np.minimum(nodes, PARTS - 1)[:, None] == np.arange(first, first + 3)
    return (PARTS * bands).astype(np.float32)


def band_means(seeds: Sequence[int], monkeypatch: pytest.MonkeyPatch, samples: int, **settings: Any) -> Images:
    """Means by band, pixel and seed; of three bands in a render."""
    tables_for = tracer.tables_for
    images = []
    for seed in seeds:
        bands = []
        for first in range(0, PARTS, 3):
            monkeypatch.setattr(
                tracer, "tables_for",
                lambda to_xyz, weights=band_weights(first): tables_for(to_xyz)._replace(rgb_weights=weights),
            )  # fmt: skip
            job = Session(RenderSettings(**{
                "samples": samples, "seed": 8 * seed + first, "threads": 2, "max_bounces": 3, "use_nee": False,
                "spectral": "ON", **settings,
            }))  # fmt: skip
            job.load(coloured_glass())
            result = job.render()
            job.close()
            assert result.report.is_spectral and result.report.reject_count == 0
            bands += list(np.moveaxis(result.passes["Combined"][..., :3].astype(np.float64), -1, 0))
        images.append(np.stack(bands[:PARTS]))
    return images


@cache
def band_reference() -> tuple[np.ndarray, ...]:
    with pytest.MonkeyPatch.context() as patch:
        return tuple(band_means(REFERENCE_SEEDS, patch, 1024))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "kind"),
    every([("NEURAL_RIS", "random"), ("VMM", "inverted"), ("NPM", "random")], 2),
)
def test_every_band_of_wavelengths_has_its_mean(method: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    mislead(method, kind, monkeypatch)
    check(band_means(seeds_of(method), monkeypatch, 1024, **guided(method)), list(band_reference()))
