# SPDX-License-Identifier: GPL-3.0-or-later
"""The light tree: probabilities add up, agree both ways, leave no light out, and scale."""

from __future__ import annotations

import time

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.builder.emission import ProgramInfo, resolve_sampling
from engine.scene.description import World
from engine.state.lights import EMITTER_NODE, GROUP_SIZE, NODE_ENERGY, NODE_WIDTH

UP = (0.0, 0.0, 1.0)


def _mixed_lamps(count: int, seed: int) -> list:
    generator = np.random.default_rng(seed)
    lamps = []
    for i in range(count):
        columns = np.linalg.qr(generator.normal(size=(3, 3)))[0]
        position = generator.uniform(-10, 10, 3)
        energy = float(generator.exponential(50.0))
        kind = ("POINT", "SPOT", "AREA", "AREA")[i % 4]
        spread = float(generator.uniform(0.3, 3.1)) if i % 8 == 3 else np.pi
        lamps.append(
            probe.lamp(kind, position, columns, energy=energy, radius=float(generator.uniform(0, 0.4)),
                       spot_angle=float(generator.uniform(0.2, 3.0)), spread=spread)
        )  # fmt: skip
    return lamps


def _receivers(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    n = generator.normal(size=(count, 3))
    return generator.uniform(-10, 10, (count, 3)), n / np.linalg.norm(n, axis=1, keepdims=True)


def _blob(count: int, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Triangles of a lumpy closed surface."""
    generator = np.random.default_rng(seed)
    corners = generator.normal(size=(count, 1, 3)) * 3.0 + generator.normal(size=(count, 3, 3)) * 0.3
    return corners.reshape(-1, 3).astype(np.float32), np.arange(3 * count, dtype=np.uint32).reshape(-1, 3)


def _scene(kind: str):
    if kind == "lamps":
        return probe.build(probe.make_description(_mixed_lamps(60, 1)))
    description, info = probe.emissive_scene(*_blob(80, 2), mode=3 if kind != "one-sided" else 1)
    if kind == "everything":
        description.lights = [*_mixed_lamps(20, 3), probe.lamp("SUN", angle=0.1, energy=2.0), probe.lamp("SUN")]
        description.world = World("w", "World", None)
        return probe.build(description, info, np.ones((8, 16, 3), np.float32))
    return probe.build(description, info)


@pytest.mark.parametrize("has_transmission", [False, True])
@pytest.mark.parametrize("kind", ["lamps", "triangles", "one-sided", "everything"])
def test_probabilities_are_those_of_the_picks(kind: str, has_transmission: bool) -> None:
    """For evenly spaced random numbers: frequencies match, returned pmf is the forward one, and the sum is 1.

    What is missing to 1 is what picks nothing: a branch that looked promising from afar.
    """
    lights, _ = _scene(kind)
    p, n = _receivers(12, 4)
    forward = probe.pmfs(lights, p, n, has_transmission)
    u = (np.arange(40_000) + 0.5) / 40_000
    rate = []
    for i in range(len(p)):
        emitters, pmf = probe.picks(lights, p[i], n[i], u, has_transmission)
        picked = emitters >= 0
        assert forward[i].sum() == pytest.approx(picked.mean(), abs=2e-3)
        # Rarely 1e-3 off: where a node is just above the horizon its cosine is the difference of two products.
        assert np.allclose(pmf[picked], forward[i, emitters[picked]], rtol=3e-3)
        counts = np.bincount(emitters[picked], minlength=forward.shape[1]) / len(u)
        assert np.abs(counts - forward[i]).max() < 1.5e-3
        rate.append(picked.mean())
    assert np.mean(rate) > 0.6


@pytest.mark.parametrize("has_transmission", [False, True])
@pytest.mark.parametrize("kind", ["lamps", "one-sided", "everything"])
def test_no_contributing_light_is_left_out(kind: str, has_transmission: bool) -> None:
    """Wherever a light's own sample would contribute, its probability is not zero."""
    lights, geometry = _scene(kind)
    p, n = _receivers(60, 5)
    forward = probe.pmfs(lights, p, n, has_transmission)
    generator = np.random.default_rng(6)
    # A tree of one emitter at a time: what it can contribute at all.
    for emitter in generator.choice(len(lights.emitters), 30, replace=False):
        node = lights.emitters[emitter, EMITTER_NODE]
        if node < 0:
            alone = lights._replace(nodes=lights.nodes[:0], distant=np.ascontiguousarray(lights.distant[[~node]]))
        else:
            group, k = divmod(int(node), GROUP_SIZE)
            nodes = np.zeros((1, NODE_WIDTH, GROUP_SIZE), np.float32)
            nodes[0, :, 0] = lights.nodes[group, :, k]
            child = np.zeros((1, GROUP_SIZE), np.int32)
            child[0, 0] = ~emitter
            alone = lights._replace(
                nodes=nodes, child=child, parent=np.full(1, -1, np.int32), distant=lights.distant[:0]
            )
        contributes = np.zeros(len(p), bool)
        for _ in range(20):
            samples = probe.draw(alone, geometry, p, n, generator.random((len(p), 3), np.float32), has_transmission)
            cosine = (samples[:, probe.WI : probe.WI + 3] * n).sum(1)
            cosine = np.abs(cosine) if has_transmission else cosine
            contributes |= (samples[:, probe.PDF] > 0.0) & (cosine > 1e-3) & (samples[:, probe.RADIANCE] > 1e-6)
        assert (forward[contributes, emitter] > 0.0).all()


def test_estimates_are_unbiased_and_quiet() -> None:
    """Irradiance from the whole scene equals the sum over single lights, at a moderate variance."""
    lamps = _mixed_lamps(40, 7)
    lights, geometry = probe.build(probe.make_description(lamps))
    p, n = np.array([1.0, -2.0, 0.5]), np.array([0.0, 0.6, 0.8])
    total = 0.0
    for lamp in lamps:
        one, _ = probe.build(probe.make_description([lamp]))
        total += probe.irradiance(probe.draw(one, geometry, p, n, probe.stratified(10_000, 3)), n).mean()
    values = probe.irradiance(
        probe.draw(lights, geometry, p, n, np.random.default_rng(2).random((200_000, 3), np.float32)), n
    )
    error = values.std() / np.sqrt(len(values))
    assert abs(values.mean() - total) < 4.0 * error + 1e-3 * total
    assert values.std() < 3.0 * total


def test_ten_thousand_emitters_build_fast() -> None:
    """Under a second of processor time (it takes a few milliseconds), one leaf each."""
    description, info = probe.emissive_scene(*_blob(10_000, 8))
    probe.build(*probe.emissive_scene(*_blob(10, 8)))
    start = time.process_time()
    lights, _ = probe.build(description, info)
    assert time.process_time() - start < 1.0
    leaves = lights.emitters[:, EMITTER_NODE]
    assert (lights.child.ravel()[leaves] == ~np.arange(10_000)).all()
    p, n = _receivers(3, 1)
    emitters, pmf = probe.picks(lights, p[0], n[0], np.random.default_rng(1).random(2000))
    forward = probe.pmfs(lights, p[:1], n[:1])[0]
    assert np.allclose(pmf[emitters >= 0], forward[emitters[emitters >= 0]], rtol=2e-3)
    assert forward.sum() == pytest.approx((emitters >= 0).mean(), abs=0.04)


@pytest.mark.parametrize("count", [1, 2, 8, 9, 60, 3000])
def test_groups_are_a_tree_over_all_emitters(count: int) -> None:
    """Each group hangs on one node, each emitter too, and nodes have the energy of what lies below them."""
    lights, _ = probe.build(probe.make_description(_mixed_lamps(count, 9)))
    child, parent, energy = lights.child, lights.parent, lights.nodes[:, NODE_ENERGY]
    below = child.ravel()
    assert sorted(~below[below < 0]) == list(range(count))
    assert sorted(below[below > 0]) == list(range(1, len(child)))
    assert parent[0] == -1 and (child.ravel()[parent[1:]] == np.arange(1, len(child))).all()
    assert (np.count_nonzero(child[1:], axis=1) >= 2).all() and np.count_nonzero(child[0]) == 1
    assert np.allclose(energy.ravel()[parent[1:]], energy[1:].sum(axis=1), rtol=1e-4)
    assert (energy[child == 0] == 0.0).all()
    # Half full or better: more would be a waste of memory.
    assert count < 1000 or np.count_nonzero(child) > 0.5 * child.size


def test_thousand_instances_of_a_mesh() -> None:
    """Every instance's triangles are emitters in world space and found again by (instance, triangle)."""
    generator = np.random.default_rng(1)
    transforms = np.tile(np.eye(4), (1000, 1, 1))
    transforms[:, :3, 3] = generator.uniform(-20, 20, (1000, 3))
    vertices = [(-0.1, -0.1, 0), (0.1, -0.1, 0), (0.1, 0.1, 0), (-0.1, 0.1, 0)]
    lights, geometry = probe.build(*probe.emissive_scene(vertices, [(0, 1, 2), (0, 2, 3)], transforms))
    assert len(lights.triangles) == 2000
    p, n = np.zeros(3), np.array(UP)
    samples = probe.draw(lights, geometry, p, n, generator.random((500, 3), np.float32))
    samples = samples[samples[:, probe.PDF] > 0.0]
    position = transforms[samples[:, probe.INSTANCE].astype(int), :3, 3]
    assert np.abs(samples[:, probe.POINT : probe.POINT + 3] - position).max() < 0.11
    assert np.allclose(probe.triangle_pdf(lights, geometry, samples, p, n), samples[:, probe.PDF], rtol=2e-3)


# ---------------------------------------------------------------------------------------------------------------------
# Bad input


def test_no_lights() -> None:
    """Nothing to sample: pdf 0."""
    lights, geometry = probe.build(probe.make_description())
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, np.random.default_rng(1).random((10, 3), np.float32))
    assert (samples[:, probe.PDF] == 0.0).all()
    assert (samples[:, probe.EMITTER] == -1).all()


def test_lights_without_energy_are_no_emitters() -> None:
    """Zero strength, zero area, NaN."""
    lamps = [
        probe.lamp("POINT", energy=0.0),
        probe.lamp("AREA", size_x=0.0),
        probe.lamp("SUN", color=(0.0, 0.0, 0.0)),
        probe.lamp("SPOT", columns=np.zeros((3, 3))),
        probe.lamp("POINT", (np.nan, 0, 0)),
    ]
    lights, _ = probe.build(probe.make_description(lamps))
    assert len(lights.emitters) == 0


def test_degenerate_triangles_are_left_out() -> None:
    """Zero area, needles and duplicates: only proper triangles become emitters."""
    vertices = [(0, 0, 1), (1, 0, 1), (0, 1, 1), (2, 0, 1)]
    triangles = [(0, 1, 2), (0, 0, 1), (0, 1, 3), (0, 1, 2), (1, 1, 1)]
    lights, geometry = probe.build(*probe.emissive_scene(vertices, triangles))
    assert len(lights.triangles) == 2
    samples = probe.draw(lights, geometry, (0, 0, 0), UP, np.random.default_rng(1).random((500, 3), np.float32))
    assert np.isfinite(samples).all()
    assert set(samples[:, probe.TRIANGLE].astype(int)) == {0, 3}


def test_emitters_in_one_place() -> None:
    """Many lights at one point build a balanced tree, all with their share."""
    lights, _ = probe.build(probe.make_description([probe.lamp("POINT", (0, 0, 1)) for _ in range(500)]))
    forward = probe.pmfs(lights, np.zeros((1, 3)), np.array([UP]))
    assert np.allclose(forward, 1.0 / 500.0, rtol=1e-3)


def test_weak_emission_is_not_sampled_in_automatic_mode() -> None:
    """As in Cycles: up to 0.5 it is left to scattered rays; a chosen side overrides."""
    info = ProgramInfo(
        np.array([True, True, True, False]),
        np.ones(4, bool),
        np.array([[0.5] * 3, [0.51, 0, 0], [0.1] * 3, [1.0] * 3], np.float32),
        np.zeros(4, np.float32),
        np.array([-1, -1, 2, 3], np.int32),
    )
    assert resolve_sampling(info).tolist() == [0, 3, 2, 0]


def test_bad_background_is_refused() -> None:
    """The shape is named."""
    with pytest.raises(ValueError, match="background map has shape"):
        probe.build(probe.make_description(world=World("w", "World", None)), background=np.zeros((4, 4), np.float32))
