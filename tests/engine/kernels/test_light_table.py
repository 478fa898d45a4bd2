# SPDX-License-Identifier: GPL-3.0-or-later
"""What the table of lights promises: samples, densities, hits and bounds of every kind agree with each other.

A kind of lamp is tested by being in `LAMP_KINDS`, with the example that its line there has. LAMPS are further ones.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.builder.lamps import LAMP_KINDS
from engine.kernels.constants import DISTANT, FAR
from engine.kernels.lights.lamps import LAMPS as TABLE
from engine.scene.description import Light, World
from engine.state import lights as la
from engine.state.geometry import GeometryArrays
from tests.helpers.chi2 import cell_integrals, histogram, p_value, sidak

P, N = (0.0, 0.0, 0.0), (0.0, 0.6, 0.8)
#: Turned, sheared, unevenly scaled and mirrored.
SKEWED = ((0.9, 0.3, 0.1), (0.2, -0.5, 0.1), (0.0, 0.3, 1.4))

LAMPS = {
    "point": probe.lamp("POINT", (0.3, -0.4, 1.0), radius=0.5, use_soft_falloff=False),
    "point soft": probe.lamp("POINT", (0.3, -0.4, 1.0), radius=0.5),
    "point around": probe.lamp("POINT", (0.3, 0.1, 0.2), radius=1.5, use_soft_falloff=False),
    "spot wide": probe.lamp("SPOT", (0.1, 0.2, 1.0), radius=0.5, use_soft_falloff=False, spot_angle=2.6, spot_blend=1),
    "spot narrow": probe.lamp("SPOT", (0.1, 0, 0.9), radius=0.8, use_soft_falloff=False, spot_angle=0.7),
    "spot soft": probe.lamp("SPOT", (0.5, 0.2, 0.8), radius=0.5, spot_angle=1.4, spot_blend=0.1),
    "spot scaled": probe.lamp("SPOT", (0.1, 0.2, 1), SKEWED, radius=0.4, use_soft_falloff=False, spot_angle=1.0),
    "square": probe.lamp("AREA", (0.3, -0.2, 0.6), size_x=1.4),
    "rectangle": probe.lamp("AREA", (0.0, 0.5, 0.4), SKEWED, shape="RECTANGLE", size_x=2.0, size_y=0.7),
    "disk": probe.lamp("AREA", (0.3, -0.2, 0.6), shape="DISK", size_x=1.4),
    "ellipse": probe.lamp("AREA", (0.1, 0.5, 0.5), SKEWED, shape="ELLIPSE", size_x=2.0, size_y=1.7),
    "square spread": probe.lamp("AREA", (0.5, -0.5, 0.6), size_x=1.4, spread=1.5),
    "disk spread": probe.lamp("AREA", (0.7, 0.0, 0.6), shape="DISK", size_x=1.4, spread=1.6),
    "disk spread inside": probe.lamp("AREA", (0.2, 0.0, 0.6), shape="DISK", size_x=3.0, spread=1.0),
    "ellipse spread": probe.lamp("AREA", (0.5, 0.3, 0.5), shape="ELLIPSE", size_x=2.0, size_y=1.0, spread=1.5),
    "sun": probe.lamp("SUN", columns=SKEWED, angle=1.0),
}
LAMPS |= {kind: probe.lamp(kind, (0.1, -0.1, 0.9), **of.example) for kind, of in LAMP_KINDS.items()}
CORNERS = np.array([(-0.5, -0.7, 0.6), (0.9, -0.4, 0.8), (0.2, 0.8, 0.6)], np.float32)
SKY = np.random.default_rng(0).random((16, 32, 3)).astype(np.float32) ** 4
CASES = [*LAMPS, "triangle", "background"]
CHI2_CASES = [(name, False) for name in CASES] + [("point around", True), ("square", True)]


class _Case(NamedTuple):
    """One light alone, and what a ray finds of it: `hits(p, n, wi, has_transmission)`, see `probe.Hits`."""

    lights: la.LightArrays
    geometry: GeometryArrays
    hits: Callable[..., probe.Hits]


@cache
def _case(name: str) -> _Case:
    if name == "triangle":
        lights, geometry = probe.build(*probe.emissive_scene(CORNERS, [(0, 1, 2)]))
        return _Case(lights, geometry, lambda *asked: probe.triangle_hits(lights, geometry, CORNERS, *asked))
    if name == "background":
        lights, geometry = probe.build(probe.make_description(world=World("w", "World", None)), background=SKY)
    else:
        lights, geometry = probe.build(probe.make_description([LAMPS[name]]))
    return _Case(lights, geometry, lambda *asked: probe.hits(lights, *asked))


def _places(name: str, count: int) -> np.ndarray:
    """Receivers around a light, in the order of its size away from it, (count, 3)."""
    generator = np.random.default_rng(count)
    middle = CORNERS.mean(axis=0) if name == "triangle" else np.zeros(3)
    if name in LAMPS:
        middle = np.asarray(LAMPS[name].transform)[:3, 3]
    return middle + generator.normal(size=(count, 3)) * generator.uniform(0.3, 4.0, (count, 1))


def _numbers(count: int, seed: int) -> np.ndarray:
    return np.random.default_rng(seed).random((count, 3), np.float32)


# ---------------------------------------------------------------------------------------------------------------------
# The table


def test_halves_of_the_table_have_the_same_kinds() -> None:
    """Each kind has kernels and a conversion, a number of its own, and an example that lights something."""
    assert {kind.lamp for kind in LAMP_KINDS.values()} == set(TABLE)
    numbers = [lamp.kind for lamp in TABLE] + [la.LIGHT_TRIANGLE, la.LIGHT_BACKGROUND]
    assert len(set(numbers)) == len(numbers)
    assert all(lamp.kind >= la.FIRST_LAMP for lamp in TABLE)
    for name, kind in LAMP_KINDS.items():
        lights = _case(name).lights
        assert lights.lamp_table[0, la.LAMP_KIND] == kind.lamp.kind
        found = (lights.header[la.HEADER_HITTABLE], lights.header[la.HEADER_LAST_DISTANT])
        assert found == ((0, 1) if kind.lamp.is_distant else (1, 1))
        assert all(hasattr(Light, field) for field in (*kind.measures, *kind.choices))


# ---------------------------------------------------------------------------------------------------------------------
# Samples, densities, hits


@pytest.mark.parametrize(("name", "has_transmission"), CHI2_CASES)
def test_samples_follow_the_density_of_hits(name: str, has_transmission: bool) -> None:
    """Chi-square at a significance of 1e-3 over the family; the density integrates to 1, but for what was rejected."""
    case = _case(name)
    samples = probe.draw(case.lights, case.geometry, P, N, _numbers(60_000, 3), has_transmission)
    good = samples[:, probe.PDF] > 0.0
    assert good.mean() > 0.3
    expected = cell_integrals(lambda d: case.hits(P, N, d, has_transmission).pdf, 24, 32, points=3, subdivisions=12)
    # The quadrature is coarse at the light's rim: what is missing to 1 is compared on its own.
    assert expected.sum() == pytest.approx(good.mean(), abs=0.02 if name == "background" else 0.012)
    observed = histogram(samples[good, probe.WI : probe.WI + 3], 24, 32)
    assert p_value(observed, expected / expected.sum(), int(good.sum())) > sidak(1e-3, len(CHI2_CASES))


@pytest.mark.parametrize("name", CASES)
def test_hits_agree_with_samples(name: str) -> None:
    """A ray along the sampled direction finds the same density, distance and radiance."""
    case = _case(name)
    samples = probe.draw(case.lights, case.geometry, P, N, _numbers(2000, 5))
    samples = samples[samples[:, probe.PDF] > 0.0]
    wi = samples[:, probe.WI : probe.WI + 3]
    assert np.allclose(np.linalg.norm(wi, axis=1), 1.0, atol=1e-5)
    assert (samples[:, probe.USE_MIS] == 1.0).all()
    found = case.hits(P, N, wi)
    distance = samples[:, probe.DISTANCE]
    # Directions to the very rim may miss it.
    is_hit = found.distance > 0.0
    assert is_hit.mean() > 0.99
    assert np.allclose(found.distance[is_hit], distance[is_hit], rtol=2e-3)
    for of_hits, of_samples in ((found.pdf, samples[:, probe.PDF]), (found.radiance, samples[:, probe.RADIANCE])):
        assert (np.abs(of_hits - of_samples) <= 2e-3 * of_samples).mean() > 0.99
    is_near = distance < FAR
    assert is_near.all() or (distance == DISTANT).all()
    point = np.asarray(P) + wi * distance[:, None] if is_near.all() else wi
    assert np.allclose(samples[:, probe.POINT : probe.POINT + 3], point, atol=2e-4)


# ---------------------------------------------------------------------------------------------------------------------
# What the light tree knows


def _node(lights: la.LightArrays) -> np.ndarray | None:
    """Columns of the only emitter's node, None if it is infinitely far away."""
    node = int(lights.emitters[0, la.EMITTER_NODE])
    return lights.nodes[node // la.GROUP_SIZE, :, node % la.GROUP_SIZE].astype(float) if node >= 0 else None


@pytest.mark.parametrize("name", CASES)
def test_bounds_contain_what_is_sampled(name: str) -> None:
    """Points lie within box and sphere, light leaves within the cone; of those far away directions are in theirs."""
    case = _case(name)
    places = _places(name, 4000)
    samples = probe.draw(case.lights, case.geometry, places, N, _numbers(4000, 7), has_transmission=True)
    shines = (samples[:, probe.PDF] > 0.0) & (samples[:, probe.RADIANCE] > 0.0)
    assert shines.sum() > 100
    samples, places = samples[shines], places[shines]
    wi, point = samples[:, probe.WI : probe.WI + 3], samples[:, probe.POINT : probe.POINT + 3]
    node = _node(case.lights)
    if node is None:
        distant = case.lights.distant[0]
        cosine = wi @ distant[la.DISTANT_DIRECTION : la.DISTANT_DIRECTION + 3]
        assert (cosine >= distant[la.DISTANT_COS] - 1e-5).all()
        return
    from_center = point - node[la.NODE_CENTER : la.NODE_CENTER + 3]
    assert (np.abs(from_center) <= node[la.NODE_HALF_SIZE : la.NODE_HALF_SIZE + 3] + 1e-4).all()
    assert (np.linalg.norm(from_center, axis=1) <= node[la.NODE_RADIUS] + 1e-4).all()
    cosine = -wi @ node[la.NODE_AXIS : la.NODE_AXIS + 3]
    cosine = np.abs(cosine) if node[la.NODE_TWO_SIDED] else cosine
    angles = np.arccos(np.clip(node[[la.NODE_COS_NORMALS, la.NODE_COS_EMISSION]], -1.0, 1.0))
    # Within the sphere a receiver is lit from anywhere.
    is_outside = np.linalg.norm(places - node[la.NODE_CENTER : la.NODE_CENTER + 3], axis=1) > node[la.NODE_RADIUS]
    assert is_outside.sum() > 50
    assert (np.arccos(np.clip(cosine, -1.0, 1.0)) <= angles.sum() + 1e-3)[is_outside].all()


@pytest.mark.parametrize("name", CASES)
def test_light_that_arrives_may_be_chosen(name: str) -> None:
    """Wherever a light shines above the horizon of a receiver, the tree gives it a probability."""
    case = _case(name)
    places = _places(name, 4000)
    samples = probe.draw(case.lights, case.geometry, places, N, _numbers(4000, 9), has_transmission=True)
    normals = np.random.default_rng(11).normal(size=(4000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    cosine = (samples[:, probe.WI : probe.WI + 3] * normals).sum(axis=1)
    arrives = (samples[:, probe.PDF] > 0.0) & (samples[:, probe.RADIANCE] > 1e-6) & (cosine > 1e-3)
    assert arrives.sum() > 50
    assert (probe.pmfs(case.lights, places[arrives], normals[arrives])[:, 0] > 0.0).all()


@pytest.mark.parametrize("name", CASES)
def test_strength_is_that_of_the_strongest_direction(name: str) -> None:
    """Nowhere far away is more radiant intensity than a node says, and somewhere half of it; a sun's is the
    irradiance of a plane that faces it, a sky's that by its mean radiance.
    """
    case = _case(name)
    node = _node(case.lights)
    generator = np.random.default_rng(13)
    directions = generator.normal(size=(300, 3))
    if node is None:
        distant = case.lights.distant[0]
        facing = distant[la.DISTANT_DIRECTION : la.DISTANT_DIRECTION + 3]
        if name == "background":
            bounds = -np.cos(np.linspace(0.0, np.pi, len(SKY) + 1))
            expected = np.pi * (SKY.mean(axis=(1, 2)) * np.diff(bounds)).sum() / 2.0
        else:
            samples = probe.draw(case.lights, case.geometry, P, facing, probe.stratified(10_000, 1))
            expected = probe.irradiance(samples, facing).mean()
        assert distant[la.DISTANT_ENERGY] == pytest.approx(expected, rel=1e-2)
        return
    directions = np.concatenate([directions, np.broadcast_to(node[la.NODE_AXIS : la.NODE_AXIS + 3], (20, 3))])
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    far = 100.0
    places = node[la.NODE_CENTER : la.NODE_CENTER + 3] + far * directions
    intensity = np.zeros(len(places))
    for index, (place, direction) in enumerate(zip(places, directions, strict=True)):
        samples = probe.draw(case.lights, case.geometry, place, -direction, probe.stratified(400, index))
        intensity[index] = probe.irradiance(samples, -direction).mean() * far * far
    assert intensity.max() < 1.02 * node[la.NODE_ENERGY]
    assert intensity.max() > 0.5 * node[la.NODE_ENERGY]
