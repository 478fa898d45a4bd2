# SPDX-License-Identifier: GPL-3.0-or-later
"""Guides that know the wavelength: densities of all four of a path's, what is learned, strata, and that none biases.

Whole renders are compared with unguided ones by `find_bias` (significance 1e-4 each).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from benchmarks.bias import find_bias
from engine.guiding.models.record_sink import training_rows
from engine.guiding.neural.networks.mixture.guide import (
    allocate_mixture_guide,
    eval_mixture,
    eval_mixture_wavelengths,
    query_mixtures,
)
from engine.guiding.neural.networks.mixture.inference import make_mixture_network
from engine.guiding.neural.networks.mixture.shape import MixtureShape, initial_parameters
from engine.guiding.neural.networks.radiance import Snapshot
from engine.guiding.neural.sources import network_design
from engine.guiding.policy import sets
from engine.guiding.records.training_rows import ROW_RADIANCE, ROW_U
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.render.session import Session
from engine.runtime.jit import kernel
from engine.scene.description import Frame, SceneDescription, World
from engine.settings import RenderSettings
from engine.state.lanes import POINT_NS, POINT_WO, WAVELENGTHS, allocate_guided_lanes, allocate_paths, allocate_points
from engine.state.unit import ALL_STRATA
from engine.wavefront.init_from_camera import place_in_stratum
from tests.helpers.guiding_harness import sphere_grid
from tests.helpers.spectral_scenes import DISPERSION, IOR, diffuse, glass, material, scene, square, wedge
from tests.helpers.untrained_networks import BOUNDS, Untrained

#: Kernels of wavelengths are kernels of their own, which take half a minute to compile.
pytestmark = pytest.mark.slow
ONE_OF_MANY = pytest.mark.one_of_many

HEROES = (0.1, 0.6, 0.95)
SHARES = ((0.25, 0.25, 0.25, 0.25), (1.0, 0.0, 0.0, 0.0), (0.1, 0.6, 0.0, 0.3))


# One vertex


@kernel
def _query(guide, guided, paths, points, lanes, wi, mean, apart):
    query_mixtures(guide, guided, paths, points, lanes, len(lanes))
    knows = False
    for k in range(len(lanes)):
        for d in range(wi.shape[0]):
            direction = wi[d, 0], wi[d, 1], wi[d, 2]
            mean[k, d] = eval_mixture(guide, k, direction)
            knows = eval_mixture_wavelengths(guide, k, direction, apart, k * wi.shape[0] + d, 0)
    return knows


def queried(
    shape: MixtureShape, wi: np.ndarray, heroes: Any = HEROES, shares: Any = SHARES, slots: int = WAVELENGTHS
) -> tuple[np.ndarray, np.ndarray, np.ndarray, bool]:
    """Densities (lanes, directions) at the same point by a wild network, those by wavelength, the guide's shares."""
    count = len(heroes)
    guide = allocate_mixture_guide(shape, count, slots)
    parameters = (4.0 * initial_parameters(shape, 5)).astype(np.float32)
    guide = guide._replace(network=make_mixture_network(shape, Snapshot(1, 1, 0.0, 1.0, BOUNDS, parameters)))
    guided, paths, points = allocate_guided_lanes(count), allocate_paths(count, WAVELENGTHS), allocate_points(count)
    guided.rough_share[:] = 1.0
    paths.hero[:] = heroes
    paths.share[:] = shares
    points.real[:, POINT_NS + 2] = points.real[:, POINT_WO + 2] = 1.0
    mean = np.zeros((count, len(wi)), np.float32)
    apart = np.full((count * len(wi), WAVELENGTHS), np.nan, np.float32)
    lanes = np.arange(count, dtype=np.int32)
    knows = _query(guide, guided, paths, points, lanes, wi.astype(np.float32), mean, apart)
    return mean, apart.reshape(count, len(wi), WAVELENGTHS), guided.probability, knows


@pytest.mark.parametrize("model", ["VMF", "NASG"])
def test_the_density_is_the_mean_over_the_wavelengths(model: str) -> None:
    shape = MixtureShape(lobe_model=model, position_encoding="BLOB", u_frequencies=4, has_selection=True)
    directions = sphere_grid()
    area = 4.0 * np.pi / len(directions)
    mean, apart, probability, knows = queried(shape, directions)
    assert knows
    shares = np.array(SHARES)
    np.testing.assert_allclose(mean, (apart * shares[:, None]).sum(axis=2), rtol=1e-4, atol=1e-7)
    # Those without a share are not asked; the others are densities, and differ.
    np.testing.assert_allclose(apart.sum(axis=1) * area, shares > 0.0, atol=0.01)
    assert (apart[0].max(axis=1) - apart[0].min(axis=1)).sum() * area > 0.05
    assert (probability > 0.0).all() and (probability < 1.0).all()


def test_one_wavelength_left_is_the_hero() -> None:
    directions = sphere_grid(20, 40)
    mean, apart, _, _ = queried(MixtureShape(position_encoding="BLOB", u_frequencies=4), directions)
    np.testing.assert_array_equal(mean[1], apart[1, :, 0])


def test_a_guide_without_wavelengths_says_so() -> None:
    _, apart, _, knows = queried(MixtureShape(position_encoding="BLOB"), sphere_grid(20, 40), slots=1)
    assert not knows and np.isnan(apart).all()


def test_every_wavelength_has_its_own_mixture() -> None:
    """Paths whose heroes are a quarter apart have the same four, and the same chance to be guided."""
    shape = MixtureShape(position_encoding="BLOB", u_frequencies=4, has_selection=True)
    shares = np.array([0.1, 0.2, 0.3, 0.4])
    turned = [shares, np.roll(shares, -1), np.roll(shares, 1)]
    mean, apart, probability, _ = queried(shape, sphere_grid(20, 40), (0.125, 0.375, 0.875), turned)
    for k, shift in ((1, -1), (2, 1)):
        np.testing.assert_allclose(apart[k], np.roll(apart[0], shift, axis=1), rtol=1e-5)
        np.testing.assert_allclose(mean[k], mean[0], rtol=1e-5)
    np.testing.assert_allclose(probability, probability[0], rtol=1e-6)


# What is learned


def spectral_records(hero: np.ndarray, spectrum: np.ndarray) -> VertexRecords:
    records = allocate_vertex_records(len(hero), WAVELENGTHS)
    records.direction[:, 2] = 1.0
    records.pdf[:] = 0.5
    records.bsdf_pdf[:] = records.guide_pdf[:] = np.nan
    records.hero[:] = hero
    records.spectrum[:] = spectrum
    records.radiance[:] = (np.nansum(spectrum, axis=1) / np.maximum((~np.isnan(spectrum)).sum(axis=1), 1))[:, None]
    return records


def test_rows_stand_for_all_wavelengths() -> None:
    """Each wavelength is picked as often as it has light, so that sums over rows are sums over all of them."""
    rng = np.random.default_rng(3)
    count = 40_000
    hero = rng.random(count).astype(np.float32)
    light = rng.gamma(0.3, size=(count, WAVELENGTHS)) * (1.0, 0.0, 2.0, 4.0)
    light[::2, 1:] = np.nan
    rows = training_rows(spectral_records(hero, light.astype(np.float32)), count, wavelengths=np.random.default_rng(4))
    assert len(rows) == count
    offset = np.mod(rows[:, ROW_U] - hero + 0.01, 1.0)
    np.testing.assert_allclose(np.mod(offset, 0.25), 0.01, atol=1e-6)
    picked = (offset * WAVELENGTHS).astype(int)
    assert (picked[::2] == 0).all()
    for c in range(WAVELENGTHS):
        expected = np.nanmean(light[1::2, c]) / WAVELENGTHS
        found = np.where(picked == c, rows[:, ROW_RADIANCE], 0.0)[1::2]
        assert abs(found.mean() - expected) < 4.5 * found.std() / np.sqrt(len(found)) + 1e-9


def test_records_of_dark_or_broken_light_have_a_wavelength() -> None:
    dark = np.zeros((4, WAVELENGTHS), np.float32)
    dark[1] = np.nan
    dark[2, 0] = np.inf
    hero = np.array([0.9999999, 0.3, 0.5, 0.0], np.float32)
    rows = training_rows(spectral_records(hero, dark), 4, wavelengths=np.random.default_rng(1))
    assert ((rows[:, ROW_U] >= 0.0) & (rows[:, ROW_U] <= 1.0)).all()


# Strata


@kernel
def _placed(u, piece_count, stratum, strata, out, found):
    for k in range(len(u)):
        out[k], found[k] = place_in_stratum(u[k], piece_count, stratum, strata)


@pytest.mark.parametrize("strata", [2, 64])
@pytest.mark.parametrize("pieces", [1, WAVELENGTHS])
def test_strata_divide_every_piece(pieces: int, strata: int) -> None:
    u = np.concatenate([(np.arange(2**12) + 0.5) / 2**12, [0.0, 1.0 - 2.0**-24]]).astype(np.float32)
    out, found, again = np.zeros_like(u), np.zeros(len(u), int), np.zeros(len(u), int)
    parts = []
    for stratum in range(strata):
        _placed(u, pieces, stratum, strata, out, found)
        assert (found == stratum).all() and out.min() >= 0.0 and out.max() < 1.0
        assert (np.floor(out * pieces) == np.floor(u * pieces)).all()
        # At the very end rounding may reach the next one.
        _placed(out, pieces, ALL_STRATA, strata, np.zeros_like(u), again)
        assert (again == stratum)[:-1].mean() > 0.999
        parts.append(out[:-2].copy())
    histogram, _ = np.histogram(np.concatenate(parts), 256, (0.0, 1.0))
    assert histogram.min() == histogram.max()


# Whole renders

#: Candidates of a mixture are weighed by what else was learned.
RESAMPLED = {
    "guiding_method": "NEURAL_RIS", "source_field": "NPM", "candidate_allocation": "FIXED", "candidate_count": 3,
}  # fmt: skip


def behind_glass(roughness: float) -> SceneDescription:
    """A wedge of strongly dispersive glass over a coloured floor, with a lamp between and another above."""
    lamp = material("Emission", Color=(1.0, 0.7, 0.4, 1.0), Strength=4.0)
    description = scene(
        [
            (wedge(), glass(IOR, roughness, DISPERSION)),
            (square(6.0, -1.0), diffuse((0.8, 0.5, 0.3))),
            (square(0.6, 1.2, 0.8), lamp),
            (square(1.5, 9.0, -4.0), lamp),
        ]
    )
    return replace(description, frame=Frame(24, 16, (0, 0, 24, 16)))


def rendered(description: SceneDescription, seeds: range, **settings: Any) -> list[np.ndarray]:
    images = []
    for seed in seeds:
        session = Session(RenderSettings(**{"samples": 511, "threads": 1, "seed": seed, **settings}))
        session.load(description)
        result = session.render()
        session.close()
        assert result.report.is_spectral and result.report.reject_count == 0
        images.append(result.passes["Combined"][..., :3])
    return images


@cache
def reference(roughness: float) -> list[np.ndarray]:
    return rendered(behind_glass(roughness), range(10, 18), samples=512)


@pytest.mark.parametrize(
    ("roughness", "scale", "settings"),
    [
        (0.3, 4.0, {"guiding_method": "NPM", "mixture_u": "PLANES"}),
        pytest.param(
            0.3, 1.0, {"guiding_method": "NASG", "mixture_u": "FREQUENCY", "network_selection": True}, marks=ONE_OF_MANY
        ),
        (0.0, 4.0, {"guiding_method": "NPM", "mixture_u": "FREQUENCY", "strata": 8}),
        pytest.param(0.3, 4.0, {**RESAMPLED, "mixture_u": "FREQUENCY"}, marks=ONE_OF_MANY),
    ],
)
def test_a_mixture_that_sees_the_wavelength_is_unbiased(
    roughness: float, scale: float, settings: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A network with parameters drawn at random is as wrong as any can be.

    The one that says how often it is chosen is milder. Of twelve of scale 4, one chose itself almost always and looked
    past the light: its picture was 22% too dark at 255 samples, and 4% at 4,095.

    Pictures are of six blocks of pixels (`benchmarks.block_noise`): six seeds say how noisy they are, two do not.
    """
    seen = []

    def make(settings: RenderSettings) -> Untrained | None:
        seen.append((settings.u_dimension, settings.mixture_u))
        return Untrained(settings, scale)

    monkeypatch.setattr(sets, "make_source_model", make)
    images = rendered(behind_glass(roughness), range(6), samples=255, guiding_trial=False, **settings)
    bias = find_bias(images, reference(roughness))
    assert not bias.is_biased and bias.detectable < 0.03, bias
    assert seen == [("WAVELENGTH", settings["mixture_u"])] * 6


class OfWavelengthAlone(Untrained):
    """Wild mixtures that are the same everywhere: what a path does by its wavelength, it does at every vertex."""

    def __init__(self, settings: RenderSettings, scale: float) -> None:
        super().__init__(settings, scale)
        shape = network_design(settings).shape
        assert isinstance(shape, MixtureShape)
        parameters = (scale * initial_parameters(shape, 3)).astype(np.float32)
        shape.split(parameters)["input_weights"][: shape.used_width - 2 * shape.u_frequencies] = 0.0
        self.field = make_mixture_network(shape, Snapshot(1, 1, 0.0, 1.0, BOUNDS, parameters))


def groove() -> SceneDescription:
    """Two white slopes under a white sky: light that is reflected twice; a grain of glass for wavelengths' sake."""
    slope = np.array([(0, -4, 0), (4, -4, 4), (4, 4, 4), (0, 4, 0)], np.float32)
    triangles = np.array([(0, 1, 2), (0, 2, 3)], np.uint32)
    white = diffuse((0.9, 0.9, 0.9))
    description = scene(
        [
            ((slope, triangles), white),
            ((slope * np.array((-1, 1, 1), np.float32), triangles), white),
            (square(0.01, -9.0), glass(IOR, 0.3, DISPERSION)),
        ],
        world=World("sky", "Sky", None, (1.0, 1.0, 1.0)),
    )
    return replace(description, frame=Frame(24, 16, (0, 0, 24, 16)))


@pytest.mark.parametrize("guiding", [{"guiding_method": "NPM"}, pytest.param(RESAMPLED, marks=ONE_OF_MANY)])
def test_wavelengths_have_their_share_in_the_density_of_the_whole_path(
    guiding: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Were the shares left as they are at the camera, the first of these pictures would be 1.9% too bright (z = 15)."""
    monkeypatch.setattr(sets, "make_source_model", lambda settings: OfWavelengthAlone(settings, 10.0))
    settings = {"mixture_u": "FREQUENCY", "guiding_trial": False, "learn_guiding_probability": False, "use_nee": False}
    images = rendered(groove(), range(6), samples=127, **settings, **guiding)
    bias = find_bias(images, rendered(groove(), range(10, 16), samples=128))
    assert not bias.is_biased and bias.detectable < 0.01, bias


@pytest.mark.parametrize("dimension", [pytest.param("NONE", marks=ONE_OF_MANY), "TIME"])
def test_without_wavelengths_asked_for_the_guide_knows_none(
    dimension: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    seen = []

    def make(settings: RenderSettings) -> Untrained:
        seen.append((settings.u_dimension, settings.mixture_u))
        return Untrained(settings, 4.0)

    monkeypatch.setattr(sets, "make_source_model", make)
    rendered(
        behind_glass(0.3), range(1), samples=16, guiding_method="NPM", mixture_u="PLANES", u_dimension=dimension,
        guiding_trial=False,
    )
    assert seen == [("NONE", "NONE")]
