# SPDX-License-Identifier: GPL-3.0-or-later
"""Lights against what the units say, and what is particular to triangles and the background.

`test_light_table.py` tests what all kinds have in common.
"""

from __future__ import annotations

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.builder.environment import build_environment_map
from engine.kernels.constants import ONE_MINUS_EPSILON
from engine.kernels.lights.background import find_cell, find_column, find_row
from engine.scene.description import World
from engine.state.lights import LIGHT_BACKGROUND
from tests.helpers.chi2 import cell_integrals, histogram, p_value, sidak

UP = (0.0, 0.0, 1.0)


@pytest.mark.parametrize("distance", [0.1, 1.0, 30.0, 3000.0])
@pytest.mark.parametrize("shape", ["square", "triangle", "sphere", "tilted triangle"])
def test_mean_inverse_density_is_the_solid_angle(shape: str, distance: float) -> None:
    """E[1 / pdf] is the solid angle of the light, near and far (where sampling changes to area)."""
    if shape == "square":
        lights, geometry = probe.build(probe.make_description([probe.lamp("AREA", (0, 0, distance), size_x=1.0)]))
        expected = 4.0 * np.arcsin(0.25 / (0.25 + distance**2))
    elif shape == "sphere":
        lights, geometry = probe.build(
            probe.make_description([probe.lamp("POINT", (0, 0, distance + 1), radius=1.0, use_soft_falloff=False)])
        )
        expected = 2.0 * np.pi * (1.0 - np.sqrt(1.0 - 1.0 / (distance + 1.0) ** 2))
        if distance > 1000:
            expected = np.pi / (distance + 1.0) ** 2
    else:
        corners = np.array([(-0.3, -0.4, 0.0), (0.9, -0.2, 0.0), (0.1, 0.8, 0.0)])
        if shape == "tilted triangle":
            corners = corners @ np.array([[0.8, 0.0, 0.5], [0.0, 1.0, 0.2], [0.0, 0.0, 0.0]])
        corners += (0.0, 0.0, distance)
        lights, geometry = probe.build(*probe.emissive_scene(corners, [(0, 1, 2)]))
        a, b, c = corners
        la, lb, lc = np.linalg.norm(corners, axis=1)
        expected = 2.0 * np.arctan2(
            abs(np.dot(a, np.cross(b, c))), la * lb * lc + (a @ b) * lc + (a @ c) * lb + (b @ c) * la
        )
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, probe.stratified(40_000, 1))
    inverse = 1.0 / samples[:, probe.PDF].astype(np.float64)
    assert np.isfinite(inverse).all()
    assert inverse.mean() == pytest.approx(expected, rel=1e-3)


def _triangle_density(corners: np.ndarray, p: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """1 / solid angle on the triangle, 0 elsewhere (float64)."""
    a, b, c = (corners - p).astype(np.float64)
    la, lb, lc = (np.linalg.norm(v) for v in (a, b, c))
    volume = np.dot(a, np.cross(b, c))
    solid_angle = 2.0 * np.arctan2(abs(volume), la * lb * lc + (a @ b) * lc + (a @ c) * lb + (b @ c) * la)
    sign = np.sign(volume)
    inside = np.ones(len(directions), bool)
    for edge in (np.cross(a, b), np.cross(b, c), np.cross(c, a)):
        inside &= sign * (directions @ edge) > 0.0
    return inside / solid_angle


@pytest.mark.parametrize("height", [0.02, 0.4, 2.0])
def test_triangle_samples_are_uniform_in_solid_angle(height: float) -> None:
    """Chi-square at a significance of 1e-3 over the family; the returned density is the forward one's."""
    corners = np.array([(-1.0, -0.7, height), (1.2, -0.4, height + 0.3), (0.2, 1.1, height)], np.float32)
    lights, geometry = probe.build(*probe.emissive_scene(corners, [(0, 1, 2)]))
    p = np.array([0.1, 0.05, 0.0], np.float32)
    samples = probe.draw(lights, geometry, p, UP, np.random.default_rng(8).random((60_000, 3), np.float32))
    expected = cell_integrals(lambda d: _triangle_density(corners, p, d), 24, 32, 3, 12)
    observed = histogram(samples[:, probe.WI : probe.WI + 3], 24, 32)
    assert p_value(observed, expected / expected.sum(), len(samples)) > sidak(1e-3, 3)
    assert np.allclose(probe.triangle_pdf(lights, geometry, samples, p, UP), samples[:, probe.PDF], rtol=1e-3)
    point = corners[0] + samples[:, [probe.U]] * (corners[1] - corners[0]) + samples[:, [probe.V]] * (
        corners[2] - corners[0]
    )
    assert np.allclose(point, samples[:, probe.POINT : probe.POINT + 3], atol=1e-5)
    assert np.allclose(p + samples[:, probe.WI : probe.WI + 3] * samples[:, [probe.DISTANCE]], point, atol=2e-4)


@pytest.mark.parametrize("mode", [1, 2, 3])
@pytest.mark.parametrize("mirrored", [False, True])
def test_triangle_is_sampled_from_its_sides(mode: int, mirrored: bool) -> None:
    """Front is where the object's own normal points, mirrored or not."""
    transform = np.diag([1.0, -1.0 if mirrored else 1.0, 1.0, 1.0])
    lights, geometry = probe.build(
        *probe.emissive_scene([(-1, -1, 0), (1, -1, 0), (0, 1, 0)], [(0, 1, 2)], [transform], mode=mode)
    )
    u = np.random.default_rng(1).random((100, 3), np.float32)
    front = probe.draw(lights, geometry, (0, 0, 1), (0, 0, -1), u)
    back = probe.draw(lights, geometry, (0, 0, -1), UP, u)
    assert ((front[:, probe.PDF] > 0.0) == bool(mode & 1)).all()
    assert ((back[:, probe.PDF] > 0.0) == bool(mode & 2)).all()
    for samples, p, n, lit in ((front, (0, 0, 1), (0, 0, -1), mode & 1), (back, (0, 0, -1), UP, mode & 2)):
        assert ((probe.triangle_pdf(lights, geometry, samples, p, n) > 0.0) == bool(lit)).all()


# ---------------------------------------------------------------------------------------------------------------------
# Units


def _mean_irradiance(light, p=(0.0, 0.0, 0.0), n=UP, count=90_000) -> float:
    lights, geometry = probe.build(probe.make_description([light]))
    return float(probe.irradiance(probe.draw(lights, geometry, p, n, probe.stratified(count, 2)), n).mean())


@pytest.mark.parametrize("radius", [0.0, 0.5])
@pytest.mark.parametrize("soft", [False, True])
def test_point_light_irradiance(radius: float, soft: bool) -> None:
    """Power / (4 pi d^2) times the cosine; exact for spheres, for discs seen from afar."""
    distance = 2.0 if not soft else 40.0
    light = probe.lamp("POINT", (0, 0.6 * distance, 0.8 * distance), radius=radius, use_soft_falloff=soft)
    assert _mean_irradiance(light) == pytest.approx(0.8 * 100.0 / (4.0 * np.pi * distance**2), rel=1e-3)


def test_spot_is_a_point_light_within_its_cone() -> None:
    """A spot of the same power shines as strong, but only within its cone."""
    for angle, factor in ((1.0, 1.0), (0.2, 0.0)):
        light = probe.lamp("SPOT", (0.4, 0, 2), spot_angle=angle, spot_blend=0.0)
        assert _mean_irradiance(light) == pytest.approx(
            factor * 100.0 / (4.0 * np.pi * 4.16) * 2.0 / np.sqrt(4.16), rel=1e-3
        )


def test_area_light_irradiance() -> None:
    """Radiance power / (pi area); irradiance below the centre of a square by the closed form."""
    side, height = 1.0, 1.0
    x = 0.5 * side / height
    form_factor = 4.0 / (2.0 * np.pi) * 2.0 * x / np.sqrt(1.0 + x * x) * np.arctan(x / np.sqrt(1.0 + x * x))
    expected = 100.0 / side**2 * form_factor
    assert _mean_irradiance(probe.lamp("AREA", (0, 0, height), size_x=side)) == pytest.approx(expected, rel=1e-3)
    radius = 0.5
    disk = probe.lamp("AREA", (0, 0, height), shape="DISK", size_x=2.0 * radius)
    expected = 100.0 / (np.pi * radius**2) * radius**2 / (radius**2 + height**2)
    assert _mean_irradiance(disk) == pytest.approx(expected, rel=1e-3)


@pytest.mark.parametrize("spread", [0.0, 0.05, 0.5, 1.5, np.pi])
@pytest.mark.parametrize("shape", ["SQUARE", "DISK"])
def test_area_light_spread_keeps_its_power(spread: float, shape: str) -> None:
    """All the power arrives on a plane close below, whatever the spread."""
    light = probe.lamp("AREA", (0, 0, 0.02), shape=shape, size_x=1.0, spread=spread)
    lights, geometry = probe.build(probe.make_description([light]))
    generator = np.random.default_rng(4)
    half = 1.5
    p = np.zeros((400_000, 3))
    p[:, :2] = generator.uniform(-half, half, (len(p), 2))
    values = probe.irradiance(probe.draw(lights, geometry, p, UP, generator.random((len(p), 3), np.float32)), UP)
    power = values * (2.0 * half) ** 2
    assert abs(power.mean() - 100.0) < 5.0 * power.std() / np.sqrt(len(p)) + 0.3


@pytest.mark.parametrize("angle", [0.0, np.radians(5.0), np.radians(60.0)])
def test_sun_irradiance(angle: float) -> None:
    """The stated irradiance arrives on a plane facing the sun, and its cosine on others."""
    assert _mean_irradiance(probe.lamp("SUN", angle=angle)) == pytest.approx(100.0, rel=1e-3)
    tilted = (0.0, 0.6, 0.8)
    assert _mean_irradiance(probe.lamp("SUN", angle=min(angle, 1.0)), n=tilted) == pytest.approx(80.0, rel=1e-3)


def test_lights_that_are_not_normalized() -> None:
    """Their power is per unit of area, so a lamp twice the size shines as bright, and more."""
    small = _mean_irradiance(probe.lamp("AREA", (0, 0, 20), size_x=1.0, is_normalized=False))
    large = _mean_irradiance(probe.lamp("AREA", (0, 0, 20), size_x=2.0, is_normalized=False))
    assert large / small == pytest.approx(4.0, rel=5e-3)
    assert small == pytest.approx(100.0 / (np.pi * 400.0), rel=5e-3)


# ---------------------------------------------------------------------------------------------------------------------
# Background


def _sky(height: int = 16) -> np.ndarray:
    generator = np.random.default_rng(0)
    image = generator.random((height, 2 * height, 3)).astype(np.float32) ** 4
    image[3, 5] = 40.0
    image[-1, 20] = 90.0
    image[0, 0] = 30.0
    return image


def test_background_samples_follow_their_density() -> None:
    """Chi-square at 1e-3, on a map with suns on the border and at a pole."""
    lights, geometry = probe.build(probe.make_description(world=World("w", "World", None)), background=_sky())
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, np.random.default_rng(9).random((60_000, 3), np.float32))
    assert (lights.emitters[samples[:, probe.EMITTER].astype(int), 0] == LIGHT_BACKGROUND).all()
    wi = samples[:, probe.WI : probe.WI + 3]
    expected = cell_integrals(lambda d: probe.hit_pdf(lights, (0, 0, 0), UP, d), 32, 32, points=3, subdivisions=8)
    assert expected.sum() == pytest.approx(1.0, abs=0.02)
    assert p_value(histogram(wi, 32, 32), expected / expected.sum(), len(samples)) > 1e-3
    forward = probe.hit_pdf(lights, (0, 0, 0), UP, wi)
    assert (np.abs(forward - samples[:, probe.PDF]) <= 1e-3 * samples[:, probe.PDF]).mean() > 0.999


def _lights_of(sky: np.ndarray, **world):
    return probe.build(probe.make_description(world=World("w", "World", None, **world)), background=sky)


def test_dim_parts_of_the_background_are_left_to_scattering() -> None:
    """Chi-square at 1e-3 against the density of hits, which is 0 where the sky is darker than its mean."""
    sky = _sky(32)
    lights, geometry = _lights_of(sky)
    u = np.random.default_rng(9).random((60_000, 3), np.float32)
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, u, leaves_dim=True)
    wi = samples[:, probe.WI : probe.WI + 3]

    def density(directions: np.ndarray) -> np.ndarray:
        return probe.hit_pdf(lights, (0, 0, 0), UP, directions, leaves_dim=True)

    expected = cell_integrals(density, 32, 32, points=3, subdivisions=8)
    assert expected.sum() == pytest.approx(1.0, abs=0.02)
    assert p_value(histogram(wi, 32, 32), expected / expected.sum(), len(samples)) > 1e-3
    directions = np.random.default_rng(10).normal(size=(4000, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    assert 0.5 < (density(directions) == 0.0).mean() < 0.95
    assert (probe.hit_pdf(lights, (0, 0, 0), UP, directions) > 0.0).all()


def test_both_techniques_find_all_of_a_compensated_background() -> None:
    """Irradiance by light sampling and by cosine-distributed scattering, each MIS-weighted, within 4 standard errors of
    light sampling alone; the standard errors would show 2%."""
    sky = np.clip(_sky(32), 0.05, 8.0)
    lights, geometry = _lights_of(sky)
    generator = np.random.default_rng(11)
    count = 400_000

    def radiance(directions: np.ndarray) -> np.ndarray:
        row = np.clip((1.0 - np.arccos(np.clip(directions[:, 2], -1, 1)) / np.pi) * 32, 0, 31).astype(int)
        column = (0.5 - np.arctan2(directions[:, 1], directions[:, 0]) / (2.0 * np.pi)) * 64
        return sky[row, np.clip(column, 0, 63).astype(int), 0]

    def sampled(leaves_dim: bool) -> tuple[np.ndarray, np.ndarray]:
        samples = probe.draw(
            lights, geometry, (0, 0, 0), UP, generator.random((count, 3), np.float32), leaves_dim=leaves_dim
        )
        wi, pdf = samples[:, probe.WI : probe.WI + 3].astype(float), samples[:, probe.PDF].astype(float)
        cosine = np.maximum(wi[:, 2], 0.0)
        return radiance(wi) * cosine / pdf, 1.0 / (1.0 + (cosine / np.pi / pdf) ** 2)

    alone, _ = sampled(False)
    value, weight = sampled(True)
    r, phi = np.sqrt(generator.random(count)), 2.0 * np.pi * generator.random(count)
    z = np.sqrt(1.0 - r**2)
    wi = np.stack([r * np.cos(phi), r * np.sin(phi), z], 1)
    other = probe.hit_pdf(lights, (0, 0, 0), UP, wi, leaves_dim=True).astype(float)
    found = np.pi * radiance(wi) / (1.0 + (other * np.pi / z) ** 2)
    error = np.sqrt((alone.var() + (value * weight).var() + found.var()) / count)
    assert error < 0.005 * alone.mean()
    assert abs((value * weight).mean() + found.mean() - alone.mean()) < 4.0 * error
    # Each by itself lacks a good part.
    assert 0.1 * alone.mean() < found.mean() < 0.95 * alone.mean()


def test_where_light_sampling_finds_other_light_the_whole_background_is_sampled() -> None:
    """A sky without shadows or with a limit of bounces, and one of one colour, have no other map."""
    assert len(_lights_of(_sky())[0].compensated_conditional)
    for lights, _ in (
        _lights_of(_sky(), cast_shadow=False), _lights_of(_sky(), max_bounces=3),
        _lights_of(np.ones((8, 16, 3), np.float32)),
    ):  # fmt: skip
        assert len(lights.map_conditional) and not len(lights.compensated_conditional)


def test_the_guide_finds_the_cells_of_a_full_search() -> None:
    """Rows and columns of next to no probability, of much, and numbers on the boundaries."""
    generator = np.random.default_rng(5)
    radiance = generator.random((40, 100, 3)).astype(np.float32) ** 20
    radiance[7] = 0.0
    radiance[20, 30] = 50.0
    environment = build_environment_map(radiance)
    marginal, conditional, guide = environment.marginal, environment.conditional, environment.guide
    numbers = np.concatenate([generator.random(500), np.arange(64) / 64.0, marginal[:-1, 0], conditional[20, :-1]])
    numbers = numbers[numbers < 1.0].astype(np.float32)
    for u in numbers:
        for line, cumulative in ((40, marginal[:, 0]), (20, conditional[20]), (7, conditional[7])):
            found = np.searchsorted(cumulative, u, side="right") - 1
            low, high = guide[line, int(u * 64)], guide[line, int(u * 64) + 1]
            assert low <= min(found, len(cumulative) - 2) <= high


@pytest.mark.parametrize("width", [3, 100, 4000])
def test_a_cell_is_that_of_a_full_search(width: int) -> None:
    """Columns that are compared many at once, and one by one where a row is short; numbers on the boundaries, too."""
    generator = np.random.default_rng(6)
    radiance = generator.random((30, width, 3)).astype(np.float32) ** 20
    radiance[7] = 0.0
    radiance[20, : width // 2] = 0.0
    radiance[20, width // 2] = 50.0
    environment = build_environment_map(radiance)
    marginal, conditional, guide = environment.marginal, environment.conditional, environment.guide
    numbers = np.concatenate([generator.random(300), np.arange(64) / 64.0, [ONE_MINUS_EPSILON], conditional[20, :-1]])
    numbers = numbers[numbers < 1.0].astype(np.float32)
    assert [find_row(marginal, guide, 30, u) for u in numbers] == list(
        np.minimum(np.searchsorted(marginal[:, 0], numbers, side="right") - 1, 29)
    )
    for row in (7, 12, 20):
        expected = np.minimum(np.searchsorted(conditional[row], numbers, side="right") - 1, width - 1)
        assert [find_column(conditional, guide, row, u) for u in numbers] == list(expected)


def test_a_direction_is_in_the_cell_that_its_angles_say() -> None:
    """All around, along the axes, and of any length; in double precision they say the same but at boundaries."""
    generator = np.random.default_rng(7)
    axes = np.concatenate([np.eye(3), -np.eye(3), [[-1.0, 1e-7, 0.0], [-1.0, -1e-7, 0.0]]])
    directions = np.concatenate([generator.normal(size=(4000, 3)), axes]).astype(np.float32)
    conditional = np.zeros((500, 1001), np.float32)
    x, y, z = directions.astype(np.float64).T
    row = (1.0 - np.arctan2(np.hypot(x, y), z) / np.pi) * 500.0
    column = (0.5 - np.arctan2(y, x) / (2.0 * np.pi)) * 1000.0
    found = np.array([find_cell(conditional, (d[0], d[1], d[2])) for d in directions])
    for index, place, count in ((found[:, 0], row, 500), (found[:, 1], column, 1000)):
        expected = np.clip(np.floor(place), 0, count - 1)
        is_near = np.abs(place - np.round(place)) < 1e-3
        assert is_near.mean() < 0.01
        assert (index == expected)[~is_near].all()
        # Longitudes of -pi and pi are the same, and poles have any.
        place = np.where((x == 0.0) & (y == 0.0) & (count == 1000), index + 0.5, place)
        assert (np.abs((index + 0.5 - place + 0.5 * count) % count - 0.5 * count) < 0.51).all()


def test_background_map_points_where_the_sun_is() -> None:
    """A bright spot at a known direction is sampled at that direction."""
    height, width = 64, 128
    image = np.zeros((height, width, 3), np.float32)
    direction = np.array([0.3, -0.5, 0.6]) / np.linalg.norm([0.3, -0.5, 0.6])
    u = 0.5 - np.arctan2(direction[1], direction[0]) / (2.0 * np.pi)
    v = 1.0 - np.arccos(direction[2]) / np.pi
    image[int(v * height), int(u * width)] = 1.0
    lights, geometry = probe.build(probe.make_description(world=World("w", "World", None)), background=image)
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, np.random.default_rng(9).random((2000, 3), np.float32))
    assert (samples[:, probe.WI : probe.WI + 3] @ direction).min() > np.cos(3.0 * np.pi / height)


def test_black_background_is_no_light() -> None:
    """Nothing to sample: not an emitter, density 0."""
    lights, _ = probe.build(
        probe.make_description(world=World("w", "World", None)), background=np.zeros((8, 16, 3), np.float32)
    )
    assert len(lights.emitters) == 0
    assert probe.hit_pdf(lights, (0, 0, 0), UP, np.array([UP]))[0] == 0.0
