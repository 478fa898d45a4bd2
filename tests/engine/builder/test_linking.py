# SPDX-License-Identifier: GPL-3.0-or-later
"""Linked lights: a light tree for each choice of emitters, and masks for each choice of blockers."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from engine.accel.masks import (
    BLOCKER_BITS,
    BLOCKER_BITS_WITHOUT_CATCHERS,
    CATCHER_MASK_SHIFT,
    MASK_MEDIUM,
    MASK_RAYCAST,
)
from engine.builder.blockers import find_blockers
from engine.builder.geometry import build_geometry
from engine.builder.lights import build_lights
from engine.builder.scene import SceneCache, build_scene
from engine.scene.description import Light, SceneDescription
from engine.scene.linking import ALL_SETS, MOST_SETS, Linking
from engine.settings import RenderSettings
from engine.state.lights import (
    DISTANT_EMITTER,
    EMITTER_LAMP,
    EMITTER_NODE,
    GROUP_SIZE,
    HEADER_UNLINKED,
    LAMP_EMITTER,
    LAMP_LIGHT,
    TREE_FIRST_DISTANT,
    TREE_LAST_DISTANT,
    TREE_ROOT,
)
from tests.helpers.light_probe import build, no_programs, picks, pmfs
from tests.helpers.small_scenes import floor_scene


def at(x: float, y: float, z: float) -> np.ndarray:
    matrix = np.eye(4, dtype=np.float32)
    matrix[:3, 3] = x, y, z
    return matrix


def lamp(kind: str, number: int) -> Light:
    return Light(kind + str(number), kind, kind, at(2.0 * number, 0, 3), (1.0, 1.0, 1.0), 10.0, radius=0.1, angle=0.1)


def linked(receiver_set: list[int], lamp_receivers: list[int], **columns: Any) -> SceneDescription:
    """Floors in sets, under five points and two suns."""
    count = len(receiver_set)
    lights = [lamp("POINT", number) for number in range(5)] + [lamp("SUN", number) for number in range(2)]
    scene = floor_scene(lights=lights, transforms=[at(0, 0, -number) for number in range(count)])
    every = np.full(max(count, 7), ALL_SETS, np.uint64)
    scene.linking = Linking(
        np.array(receiver_set, np.int32), np.zeros(count, np.int32), every[:count], every[:count],
        np.array(lamp_receivers, np.uint64), every[:7],
    )  # fmt: skip
    scene.linking = replace(scene.linking, **columns)
    return scene


#: Bits of lamps: set 0 is lit by all but the first two, set 1 by all but the third, set 2 as set 0.
LAMPS = [2, 2, 5, ALL_SETS, ALL_SETS, ALL_SETS, 2]


def test_there_is_a_tree_for_each_choice_of_emitters() -> None:
    lights, _ = build(linked([0, 1, 2, 1], LAMPS))
    links = lights.links
    assert len(links.trees) == 2
    assert links.receivers[:, 0].tolist() == [0, 1, 0, 1]
    assert lights.header[HEADER_UNLINKED] == 7
    assert (links.lamps & 1)[np.argsort(lights.lamp_table[:, LAMP_LIGHT])].tolist() == [0, 0, 1, 1, 1, 1, 0]
    rows = links.rows.reshape(2, 7)
    for tree in range(2):
        seen = rows[tree][rows[tree] >= 0]
        assert (links.tree[seen] == tree).all()
        names = lights.lamp_table[lights.emitters[seen, EMITTER_LAMP], LAMP_LIGHT]
        assert sorted(names.tolist()) == [k for k, bits in enumerate(LAMPS) if bits >> tree & 1]


def test_each_emitter_is_found_from_its_leaf_and_from_its_root() -> None:
    lights, _ = build(linked([0, 1, 2, 1], LAMPS))
    for tree, row in enumerate(lights.links.trees):
        reached = []
        groups = [int(lights.child[row[TREE_ROOT], 0])]
        while groups:
            group = groups.pop()
            if group < 0:
                reached.append(~group)
                continue
            below = lights.child[group]
            groups += below[below != 0].tolist()
        for emitter in reached:
            assert lights.links.tree[emitter] == tree
            node = int(lights.emitters[emitter, EMITTER_NODE])
            while lights.parent[node // GROUP_SIZE] >= 0:
                node = int(lights.parent[node // GROUP_SIZE])
            assert node == GROUP_SIZE * row[TREE_ROOT]
        suns = lights.distant[row[TREE_FIRST_DISTANT] : row[TREE_LAST_DISTANT], DISTANT_EMITTER].astype(int).tolist()
        assert sorted(reached + suns) == np.flatnonzero(lights.links.tree == tree).tolist()


def test_probabilities_of_a_tree_sum_to_one_and_are_those_of_picking() -> None:
    lights, _ = build(linked([0, 1], LAMPS))
    rng = np.random.default_rng(3)
    p, n = np.array([[1.0, 0.5, 0.0]], np.float32), np.array([[0.0, 0.0, 1.0]], np.float32)
    probability = pmfs(lights, p, n)[0]
    for tree in range(2):
        assert probability[lights.links.tree == tree].sum() == pytest.approx(1.0, abs=1e-5)
    found, _ = picks(lights, p, n, rng.random(4000), tree=1)
    assert (lights.links.tree[found] == 1).all()
    share = np.bincount(found, minlength=len(probability)) / 4000
    mine = lights.links.tree == 1
    assert np.abs(share - np.where(mine, probability, 0.0)).max() < 4.0 * 0.5 / 4000**0.5


def joined(scene: SceneDescription, has_inside: list[bool], world: int = -1) -> tuple[Any, list[Any]]:
    """Lights of a scene with media inside of some instances, and notices."""
    media: Any = SimpleNamespace(has_inside=np.array(has_inside), arrays=SimpleNamespace(world=np.array([world])))
    notices: list[Any] = []
    return build_lights(scene, build_geometry(scene, [], []), no_programs(), None, notices, media), notices


def lamps_of(lights: Any, tree: int) -> list[int]:
    """Numbers of the lamps in a light tree."""
    rows = lights.links.rows.reshape(len(lights.links.trees), -1)[tree]
    return sorted(lights.lamp_table[lights.emitters[rows[rows >= 0], EMITTER_LAMP], LAMP_LIGHT].tolist())


def test_two_media_that_overlap_have_a_tree_of_what_lights_both() -> None:
    lights, notices = joined(linked([0, 1, 2, 1], LAMPS), [False, True, True, False])
    first, second = lights.links.receivers[1, 0], lights.links.receivers[2, 0]
    both = lights.links.joined[first, second]
    assert len(lights.links.trees) == 3 and notices == []
    assert both == lights.links.joined[second, first] and both not in (first, second)
    assert lamps_of(lights, both) == sorted({*lamps_of(lights, first)} & {*lamps_of(lights, second)}) == [3, 4, 5]
    assert [lights.links.joined[tree, tree] for tree in range(3)] == [0, 1, 2]
    assert (lights.links.lamps >> int(both) & 1)[np.argsort(lights.lamp_table[:, LAMP_LIGHT])].tolist() == [
        0, 0, 0, 1, 1, 1, 0
    ]  # fmt: skip


def test_the_world_s_medium_is_in_no_collection() -> None:
    lights, _ = joined(linked([1, 1], LAMPS), [True, False], world=0)
    assert lamps_of(lights, lights.links.joined[0, lights.links.receivers[0, 0]]) == [3, 4, 5]
    # One medium alone joins nothing.
    assert len(joined(linked([1, 1], LAMPS), [True, False])[0].links.trees) == 2


def test_more_choices_of_overlapping_media_than_rays_tell_apart_are_named() -> None:
    """Twelve media have 66 pairs, each with two lamps less than all."""
    scene = linked(list(range(1, 13)), [ALL_SETS] * 7)
    scene.lights = [lamp("POINT", number) for number in range(12)]
    assert scene.linking is not None
    scene.linking.lamp_receivers = np.array([ALL_SETS - 2 ** (number + 1) for number in range(12)], np.uint64)
    scene.linking.lamp_blockers = np.full(12, ALL_SETS, np.uint64)
    lights, notices = joined(scene, [True] * 12)
    assert len(lights.links.trees) == MOST_SETS
    assert "overlap" in notices[0].problem and len(notices) == 1
    trees = lights.links.receivers[:, 0]
    shared = [(a, b) for a in trees for b in trees if a != b]
    known = [tree for a, b in shared if (tree := lights.links.joined[a, b]) != a]
    assert len(shared) - len(known) == 2 * (66 - (MOST_SETS - 13))
    assert all(len(lamps_of(lights, tree)) == 10 for tree in known)


def test_what_links_nothing_costs_nothing() -> None:
    scene = linked([0, 1], [ALL_SETS] * 7)
    lights, _ = build(scene)
    assert lights.links.receivers.shape == (0, 0)
    assert lights.links.blockers.shape == (0, 0)
    plain, _ = build(replace(scene, linking=None))
    for name in ("receivers", "rows", "hidden", "blockers"):
        assert getattr(lights.links, name).shape == getattr(plain.links, name).shape
    assert (lights.lamp_table[:, LAMP_EMITTER] == np.arange(7)).all()


def test_blockers_have_masks() -> None:
    scene = linked(
        [0, 0, 0], [ALL_SETS] * 7, blocker_set=np.array([0, 1, 2], np.int32),
        lamp_blockers=np.array([ALL_SETS, 2, 5, 2, 0, ALL_SETS, ALL_SETS], np.uint64),
    )
    blockers = find_blockers(scene.linking, has_catchers=False)
    assert blockers is not None
    assert not blockers.notices
    assert blockers.lamps[[0, 5, 6]].tolist() == [0, 0, 0]
    assert blockers.lamps[1] == blockers.lamps[3]
    of_lamps = (blockers.bits[None, :] & blockers.lamps[:, None].astype(np.uint32)) != 0
    assert of_lamps[1].tolist() == [False, True, False]
    assert of_lamps[2].tolist() == [True, False, True]
    assert blockers.lamps[4] != 0
    assert not of_lamps[4].any()
    built = build_scene(scene, RenderSettings(), SceneCache(), threads=1)
    assert ((built.accelerator.masks & np.uint32(blockers.lamps[1])) != 0).tolist() == [False, True, False]


@pytest.mark.parametrize(("has_catchers", "room"), [(True, 6), (False, 21)])
def test_too_many_choices_of_blockers_are_named(has_catchers: bool, room: int) -> None:
    count = room + 2
    scene = linked([0] * count, [ALL_SETS] * 7, blocker_set=np.arange(count, dtype=np.int32))
    assert scene.linking is not None
    bits = np.array([2**number for number in range(count)], np.uint64)
    blockers = find_blockers(replace(scene.linking, surface_blockers=bits), has_catchers=has_catchers)
    assert blockers is not None
    assert (blockers.surfaces == 0).sum() == count - room
    assert [notice.problem for notice in blockers.notices] == [
        f"more than {room} different choices of blockers are not supported"
    ]
    # Of those that have room each is hidden by the one object of its choice alone.
    found = blockers.surfaces[:room].astype(np.uint32)[:, None] & blockers.bits[None, :]
    assert ((found != 0) == np.eye(room, count, dtype=bool)).all()


def test_bits_of_blockers_are_no_others() -> None:
    bits = set(BLOCKER_BITS_WITHOUT_CATCHERS)
    assert set(BLOCKER_BITS) <= bits
    assert max(BLOCKER_BITS) < CATCHER_MASK_SHIFT
    assert MASK_RAYCAST < 1 << CATCHER_MASK_SHIFT
    taken = 2 * MASK_MEDIUM - 1 | MASK_RAYCAST
    assert not any(taken >> bit & 1 for bit in bits)


@pytest.mark.parametrize(
    ("columns", "message"),
    [
        ({"receiver_set": np.zeros(3, np.int32)}, "must have 2 elements"),
        ({"lamp_receivers": np.zeros(3, np.uint64)}, "must have 7 elements"),
        ({"blocker_set": np.array([0, MOST_SETS], np.int32)}, "blocker_set must be from 0 to 63"),
        ({"receiver_set": np.array([0, -1], np.int32)}, "receiver_set must be from 0 to 63"),
    ],
)
def test_bad_links_are_refused(columns: dict[str, np.ndarray], message: str) -> None:
    scene = linked([0, 1], LAMPS)
    assert scene.linking is not None
    scene.linking = replace(scene.linking, **columns)
    with pytest.raises(ValueError, match=message):
        build_scene(scene, RenderSettings(), SceneCache(), threads=1)
