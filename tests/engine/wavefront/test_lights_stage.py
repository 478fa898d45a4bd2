# SPDX-License-Identifier: GPL-3.0-or-later
"""The stage that finds lamps by scattering: with light sampling it adds up to the whole, and it heeds every switch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.runtime.bundle import Bundle
from engine.scene.description import VISIBLE_ALL, VISIBLE_CAMERA, VISIBLE_DIFFUSE
from engine.scene.fast_gi import FastGi
from engine.settings import RenderSettings
from engine.spectral.tables import SpectralTables, no_spectral_tables
from engine.state.film import FilmTile, allocate_tile
from engine.state.lanes import (
    RAY_CAMERA,
    RAY_DIFFUSE,
    RAY_MIS_SKIP,
    FeatureLanes,
    LightPassLanes,
    PathState,
    allocate_feature_lanes,
    allocate_light_pass_lanes,
    allocate_paths,
)
from engine.state.lights import LightArrays
from engine.state.media import LOBE_WIDTH, MEDIUM_WIDTH, MediaArrays, MediaLanes, allocate_media_lanes
from engine.state.photons import (
    CasterArrays,
    PhotonLanes,
    PhotonMap,
    allocate_photon_lanes,
    no_casters,
    no_photons,
)
from engine.state.tracking import TrackedLanes, allocate_tracked_lanes, no_majorants
from engine.wavefront.columns import SCENE_HEADER_WIDTH, UNIT_HEADER_WIDTH
from engine.wavefront.options import IntegratorOptions, make_options
from engine.wavefront.shade_lights import shade_lights
from engine.wavefront.work import allocate_queue

UP = (0.0, 0.0, 1.0)


def _paths(directions: Any, flags: int, pdf: Any = 0.0, hit_distance: float = 1e30) -> Any:
    directions = np.atleast_2d(np.asarray(directions, np.float32))
    paths = allocate_paths(len(directions))
    paths.direction[:] = directions
    paths.throughput[:] = 1.0
    paths.unguided[:] = 1.0
    paths.mis_normal[:] = UP
    paths.mis_pdf[:] = pdf
    paths.flags[:] = flags
    paths.depth[:] = 1
    paths.hit_distance[:] = hit_distance
    paths.hit_instance[:] = -1 if hit_distance > 1e20 else 0
    paths.reach[:] = np.inf
    return paths


class _Scene(Bundle):
    """What the stage reads of a scene."""

    header: np.ndarray
    lights: LightArrays
    casters: CasterArrays
    photons: PhotonMap
    media: MediaArrays
    spectrum: SpectralTables
    options: IntegratorOptions


class _Work(Bundle):
    """What it reads and writes of a thread's memory."""

    paths: PathState
    f_cos: np.ndarray
    passes: LightPassLanes
    features: FeatureLanes
    media: MediaLanes
    tracking: TrackedLanes
    photons: PhotonLanes


class _Unit(Bundle):
    """What it reads and writes of a unit: no passes are asked for."""

    header: np.ndarray
    film: FilmTile


def _shade(lights: Any, paths: Any, **settings: Any) -> np.ndarray:
    count = len(paths.flags)
    media = MediaArrays(
        np.zeros((1, MEDIUM_WIDTH), np.float32), np.full(1, -1, np.int32), np.zeros((1, LOBE_WIDTH), np.float32),
        np.zeros(2, np.int32), np.full(1, -1, np.int32), np.full(1, -1, np.int32), no_majorants(0),
    )
    header = np.zeros(SCENE_HEADER_WIDTH, np.int64)
    options = make_options(RenderSettings(**settings), 1.0, 10.0, FastGi())
    scene = _Scene(header, lights, no_casters(lights), no_photons(), media, no_spectral_tables(), options)
    queue = allocate_queue(count)
    queue.lanes[:], queue.count[0] = np.arange(count), count
    work = _Work(
        paths, np.zeros((count, 3), np.float32), allocate_light_pass_lanes(count, 3, 0), allocate_feature_lanes(1, 1),
        allocate_media_lanes(0, 3), allocate_tracked_lanes(1, 3), allocate_photon_lanes(1, 1, 1, 1),
    )
    shade_lights(scene, _Unit(np.zeros(UNIT_HEADER_WIDTH, np.int64), allocate_tile(1, 3)), work, queue)
    return paths.radiance.copy()


def _scattered(lights: Any, count: int, seed: int, **settings: Any) -> np.ndarray:
    """Irradiance at the origin gathered by cosine-distributed rays through the stage, one value a ray."""
    generator = np.random.default_rng(seed)
    r, phi = np.sqrt(generator.random(count)), 2.0 * np.pi * generator.random(count)
    z = np.sqrt(1.0 - r**2)
    directions = np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)
    paths = _paths(directions, RAY_DIFFUSE, z / np.pi)
    return _shade(lights, paths, **settings)[:, 0] * np.pi


@pytest.mark.parametrize(
    "lamps",
    [
        [probe.lamp("POINT", (0.3, 0, 1), radius=0.6, use_soft_falloff=False)],
        [probe.lamp("POINT", (0.3, 0, 1), radius=0.6)],
        [probe.lamp("SPOT", (0.3, 0, 1), radius=0.6, use_soft_falloff=False, spot_angle=1.5)],
        [probe.lamp("AREA", (0.3, 0, 0.8), size_x=1.5)],
        [probe.lamp("AREA", (0.3, 0, 0.8), shape="ELLIPSE", size_x=1.5, size_y=2.0, spread=1.8)],
        [probe.lamp("SUN", angle=1.2)],
        [
            probe.lamp("SUN", angle=1.2),
            probe.lamp("AREA", (0.3, 0, 0.8), size_x=1.5),
            probe.lamp("POINT", (0.5, 0, 0.5), radius=0.4, use_soft_falloff=False),
            probe.lamp("POINT", (0.0, 0, 0.5)),
        ],
    ],
    ids=["sphere", "disc", "spot", "square", "ellipse", "sun", "all"],
)
def test_both_techniques_add_up(lamps: list) -> None:
    """Sampling and scattering, each with its MIS weight, sum to what sampling alone gives (4 standard errors)."""
    lights, geometry = probe.build(probe.make_description(lamps))
    count = 120_000
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, np.random.default_rng(1).random((count, 3), np.float32))
    alone = probe.irradiance(samples, UP)
    pdf = samples[:, probe.PDF].astype(np.float64)
    other = np.maximum(samples[:, probe.WI + 2], 0.0) / np.pi
    weight = np.where(samples[:, probe.USE_MIS] > 0.0, pdf**2 / np.maximum(pdf**2 + other**2, 1e-30), 1.0)
    sampled = alone * weight
    found = _scattered(lights, count, 2)
    assert found.mean() > 0.01 * alone.mean()
    error = np.sqrt((alone.var() + sampled.var() + found.var()) / count)
    assert abs(sampled.mean() + found.mean() - alone.mean()) < 4.0 * error


def test_without_light_sampling_lamps_count_whole() -> None:
    """`use_nee` off: scattered rays carry everything, lamps without MIS included."""
    lamp = probe.lamp("AREA", (0.3, 0, 0.8), size_x=1.5, use_mis=False)
    lights, geometry = probe.build(probe.make_description([lamp]))
    alone = probe.irradiance(probe.draw(lights, geometry, (0, 0, 0), UP, probe.stratified(40_000, 1)), UP)
    assert _scattered(lights, 1000, 3).max() == 0.0
    found = _scattered(lights, 120_000, 3, use_nee=False)
    assert abs(found.mean() - alone.mean()) < 4.0 * found.std() / np.sqrt(len(found))


def test_visibility() -> None:
    """Camera rays see lamps visible to the camera, scattered rays those visible to their kind."""
    seen = {}
    for visibility in (VISIBLE_ALL, VISIBLE_ALL & ~VISIBLE_CAMERA, VISIBLE_ALL & ~VISIBLE_DIFFUSE):
        lights, _ = probe.build(probe.make_description([probe.lamp("AREA", (0, 0, 1), visibility=visibility)]))
        camera = _shade(lights, _paths(UP, RAY_CAMERA | RAY_MIS_SKIP))[0, 0] > 0.0
        diffuse = _shade(lights, _paths(UP, RAY_DIFFUSE, 1.0))[0, 0] > 0.0
        seen[visibility] = (camera, diffuse)
    assert list(seen.values()) == [(True, True), (False, True), (True, False)]


def test_only_what_is_before_the_surface_counts() -> None:
    """A lamp behind the hit adds nothing; two lamps before it both add; a sun needs a miss."""
    lights, _ = probe.build(
        probe.make_description(
            [probe.lamp("AREA", (0, 0, 1)), probe.lamp("AREA", (0, 0, 2)), probe.lamp("SUN", angle=0.5)]
        )
    )
    radiance = 100.0 / np.pi
    sun = 100.0 / (np.pi * np.sin(0.25) ** 2)
    for distance, expected in ((0.5, 0.0), (1.5, radiance), (3.0, 2.0 * radiance), (1e30, 2.0 * radiance + sun)):
        result = _shade(lights, _paths(UP, RAY_CAMERA | RAY_MIS_SKIP, hit_distance=distance))
        assert result[0] == pytest.approx(expected, rel=1e-4)
    # Past a transparent surface: the range moves on, what lies behind its start is not counted again.
    paths = _paths(UP, RAY_CAMERA | RAY_MIS_SKIP, hit_distance=1.0)
    paths.mis_distance[:] = 1.5
    paths.origin[:, 2] = 1.5
    assert _shade(lights, paths)[0] == pytest.approx(radiance, rel=1e-4)


def test_clamping() -> None:
    """Direct light found by scattering is limited like all other."""
    lights, _ = probe.build(probe.make_description([probe.lamp("AREA", (0, 0, 1))]))
    paths = _paths(UP, RAY_CAMERA | RAY_MIS_SKIP)
    assert _shade(lights, paths, clamp_direct=2.0)[0] == pytest.approx(2.0)


def test_no_lamps_cost_nothing() -> None:
    """Without lamps nothing is touched."""
    lights, _ = probe.build(probe.make_description())
    assert (_shade(lights, _paths(UP, RAY_CAMERA | RAY_MIS_SKIP)) == 0.0).all()
