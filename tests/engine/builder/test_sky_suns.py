# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns of a world's sky: where they are found, and that each is sampled apart from the map, with one density."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.builder.environment import EnvironmentMap, build_environment_map, without_discs
from engine.builder.sky_suns import SkySuns, find_sky_suns
from engine.scene.description import Link, Node, NodeGraph, World
from engine.shaders.nodes_sky import Sun, sun_angles
from engine.state.lights import HEADER_CLUSTERS

UP = (0.0, 0.0, 1.0)
SUNS = SkySuns((Sun((0.0, 0.6, 0.8), 0.01), Sun((0.6, 0.0, 0.8), 0.2)))


def world_of(*nodes: Node) -> World:
    return World("w", "World", NodeGraph(list(nodes), surface=Link(0, "Background")))


def sky(inputs: dict | None = None, **properties: object) -> Node:
    return Node("ShaderNodeTexSky", "Sky", inputs or {}, {"sun_disc": True, "sun_size": 0.02, **properties})


def test_suns_stand_where_the_node_says() -> None:
    (sun,) = find_sky_suns(world_of(sky(sun_elevation=0.5, sun_rotation=0.5 * math.pi))).suns
    # North is y; the sun turns towards x.
    np.testing.assert_allclose(sun.direction, (math.cos(0.5), 0.0, math.sin(0.5)), atol=1e-12)
    assert sun.half_angle == 0.01
    assert len(find_sky_suns(world_of(sky(), sky(sun_rotation=1.0), sky())).suns) == 2
    for none in (
        sky(sun_disc=False), sky(sun_size=0.0), sky(sun_elevation=-0.3), sky(sky_type="PREETHAM"),
        sky(sky_type="HOSEK_WILKIE"),
    ):  # fmt: skip
        assert find_sky_suns(world_of(none)) == SkySuns()
    assert find_sky_suns(None) == find_sky_suns(World("w", "World", None)) == SkySuns()
    moved = find_sky_suns(world_of(sky({"Vector": Link(0, "Vector")})))
    assert moved.suns == () and moved.has_others


@pytest.mark.parametrize("elevation", [-7.0, -2.0, -0.4, 0.3, 2.0, 4.0, 9.0])
def test_angles_beyond_the_zenith_are_the_same_sun(elevation: float) -> None:
    turned, rotation = sun_angles(elevation, 0.7)
    assert -0.5 * math.pi <= turned <= 0.5 * math.pi and 0.0 <= rotation <= 2.0 * math.pi
    across = math.cos(turned)
    direction = (-across * math.sin(rotation), across * math.cos(rotation), math.sin(turned))
    expected = [math.cos(elevation) * math.sin(0.7), math.cos(elevation) * math.cos(0.7), math.sin(elevation)]
    np.testing.assert_allclose(direction, expected, atol=1e-9)


def _environment() -> EnvironmentMap:
    grid = np.random.default_rng(3).uniform(0.5, 1.5, (64, 128, 3)).astype(np.float32)
    discs = SUNS.discs()
    left = without_discs(grid, discs)
    assert 0 < (left == 0.0).any(axis=2).sum() < 0.1 * left[..., 0].size and (grid > 0.0).all()
    return replace(build_environment_map(left), discs=discs, disc_radiance=np.array([5000.0, 20.0], np.float32))


def test_points_of_a_disc_lie_in_it() -> None:
    for points, sun in zip(SUNS.points(), SUNS.suns, strict=True):
        np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1.0)
        angle = np.arccos(np.clip(points @ sun.direction, -1.0, 1.0))
        assert (angle < sun.half_angle).all() and angle.max() > 0.9 * sun.half_angle


@pytest.mark.parametrize("is_learned", [False, True])
def test_every_direction_is_drawn_by_one_of_map_and_suns(is_learned: bool) -> None:
    """The density of a hit is that of the sample, and its integral is 1 but for what the map draws within discs."""
    world = World("w", "World", None)
    # A lamp stands before the suns in all lists.
    lamps = [probe.lamp("SUN", angle=0.1, energy=1e-3)]
    lights, geometry = probe.build(probe.make_description(lamps, world=world), background=_environment())
    if is_learned:
        probability = np.ones(lights.header[HEADER_CLUSTERS])
        probability[:3] = 1e-9, 60.0, 60.0
        lights = probe.with_selection(lights, probability)
    generator = np.random.default_rng(4)
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, generator.random((40_000, 3), np.float32))
    pdf, wi = samples[:, probe.PDF], samples[:, probe.WI : probe.WI + 3]
    kept = pdf > 0.0
    assert 0.9 < kept.mean() < 1.0
    forward = probe.hit_pdf(lights, (0, 0, 0), UP, wi[kept])
    assert (np.abs(forward - pdf[kept]) <= 2e-3 * pdf[kept]).mean() > 0.999
    solid_angle = 0.0
    for sun in SUNS.suns:
        inside = wi @ np.array(sun.direction) > 1.0 - 2.0 * math.sin(0.5 * sun.half_angle) ** 2
        emitter = samples[kept & inside, probe.EMITTER]
        assert len(emitter) > 1000 and (emitter == emitter[0]).all()
        area = 4.0 * math.pi * math.sin(0.5 * sun.half_angle) ** 2
        solid_angle += area
        # Uniform over the disc: 1 / density is its solid angle over the probability of the choice.
        found = forward[inside[kept]]
        assert found.std() < 1e-3 * found.mean()
        assert found.mean() * area == pytest.approx((kept & inside).mean(), rel=0.05)
    directions = generator.normal(size=(200_000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    outside = np.all([directions @ np.array(s.direction) < math.cos(s.half_angle) for s in SUNS.suns], axis=0)
    density = probe.hit_pdf(lights, (0, 0, 0), UP, directions[outside])
    of_map = density.astype(np.float64).mean() * (4.0 * math.pi - solid_angle)
    within = sum((kept & (wi @ np.array(s.direction) > math.cos(s.half_angle))).mean() for s in SUNS.suns)
    assert of_map + within == pytest.approx(kept.mean(), abs=0.01)
