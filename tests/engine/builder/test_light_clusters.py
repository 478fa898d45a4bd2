# SPDX-License-Identifier: GPL-3.0-or-later
"""Clusters of lights: every emitter is in one, and patches of the background add up to it."""

from __future__ import annotations

import numpy as np
import pytest

import tests.helpers.light_probe as probe
from engine.builder.light_clusters import CUT_SIZE
from engine.scene.description import World
from engine.state.lights import (
    EMITTER_NODE,
    GROUP_SIZE,
    HEADER_BANDS,
    HEADER_CLUSTERS,
    HEADER_CUT,
    HEADER_FIRST_PATCH,
    HEADER_SECTORS,
)


def _lamps(count: int) -> list:
    places = np.random.default_rng(3).uniform(-10, 10, (count, 3))
    return [probe.lamp("AREA", place, energy=1.0 + k) for k, place in enumerate(places)]


@pytest.mark.parametrize("count", [1, 5, 40, 700])
def test_every_emitter_is_below_one_node_of_the_cut(count: int) -> None:
    lights, _ = probe.build(probe.make_description(_lamps(count)))
    found = []
    for node in lights.emitters[:, EMITTER_NODE]:
        clusters = []
        while node >= 0:
            if lights.node_cluster[node] >= 0:
                clusters.append(int(lights.node_cluster[node]))
            node = lights.parent[node // GROUP_SIZE]
        assert len(clusters) == 1
        found += clusters
    cut = int(lights.header[HEADER_CUT])
    assert set(found) == set(range(cut))
    assert min(count, CUT_SIZE) <= cut < CUT_SIZE + 8
    assert (lights.node_cluster[lights.cluster_node] == np.arange(cut)).all()


@pytest.mark.parametrize("size", [(2, 4), (5, 11), (64, 128)])
def test_patches_add_up_to_the_map(size: tuple[int, int]) -> None:
    radiance = np.random.default_rng(4).random((*size, 3)).astype(np.float32)
    radiance[: size[0] // 2] *= 1e-3
    lights, _ = probe.build(
        probe.make_description([probe.lamp("SUN")], World("w", "World", None)), background=radiance
    )
    first, count = lights.header[HEADER_FIRST_PATCH], lights.header[HEADER_CLUSTERS]
    assert first == 1 and count - first == lights.header[HEADER_BANDS] * lights.header[HEADER_SECTORS]
    assert lights.cluster_share[first:].sum() == pytest.approx(1.0, abs=1e-5)
    assert (np.diff(lights.map_patches, axis=1) >= 0.0).all()
    assert (lights.map_patches[:, 0] == 0.0).all() and (lights.map_patches[:, -1] == 1.0).all()


def test_without_lights_there_are_no_clusters() -> None:
    lights, _ = probe.build(probe.make_description())
    assert lights.header[HEADER_CLUSTERS] == len(lights.cluster_share) == 0
