# SPDX-License-Identifier: GPL-3.0-or-later
"""What workers record is learned from as if one process had: the picture is the same to the last bit.

The workers are calls in this process, each with what would come over the network.
"""

from __future__ import annotations

import pickle
import random
import time
from dataclasses import replace

import numpy as np
import pytest

from engine.cluster.session import ClusterSession
from engine.cluster.work import FAILED, SUMS, Answer, trace, unpack_traced
from engine.render.checkpointing import Checkpointing, CheckpointPlan
from engine.render.session import Session
from engine.runtime.source_version import source_version
from engine.scene.description import Mesh
from engine.scene.digest import SceneDigest
from engine.scene.rounds import ROUND, Rounds
from engine.settings import RenderSettings
from tests.helpers.fur_scenes import fur_on_skin
from tests.helpers.small_scenes import corner_scene

PASSES = ("Combined", "Variance", "Depth")
#: Tiles of 32 x 32: six.
SCENE = corner_scene(size=(96, 64))


class WorkersHere:
    """So many workers that do their orders in any order."""

    def __init__(self, count):
        self.orders = []
        self.scene = self.learned = b""
        self._names = frozenset(f"worker {index}" for index in range(count))
        self._waiting = []
        self._random = random.Random(count)

    @property
    def now(self):
        return time.monotonic()

    def hold(self, scene, blob):
        self.scene = blob

    def hold_learned(self, learned, blob):
        self.learned = blob

    def workers(self):
        return self._names

    def submit(self, ticket, worker, order):
        self.orders.append((order, self.learned))
        self._waiting.append((ticket, order, self.learned))

    def take(self, seconds):
        if not self._waiting:
            time.sleep(min(seconds, 0.01))
            return None
        ticket, order, learned = self._waiting.pop(self._random.randrange(len(self._waiting)))
        return ticket, Answer(*trace(source_version(), order, self.scene, learned))

    def cancel(self, tickets):
        self._waiting = [item for item in self._waiting if item[0] not in tickets]

    def close(self):
        pass


def by_one(settings, scene=SCENE, **options):
    session = Session(replace(settings, deterministic=True))
    session.load(scene)
    return session.render(passes=PASSES, **options)


def by_workers(pool, settings, scene=SCENE, **options):
    session = ClusterSession(settings, pool)
    session.load(scene)
    return session.render(passes=PASSES, **options)


def is_same(a, b):
    return all(np.array_equal(a.passes[name], b.passes[name]) for name in PASSES)


@pytest.mark.parametrize(
    "changes",
    [
        {"guiding_method": "VMM", "samples": 24},
        {"guiding_method": "VMM", "samples": 64, "use_adaptive_sampling": True, "adaptive_threshold": 0.05},
        {"guiding_method": "VMM", "samples": 64, "use_denoising": True, "denoised_threshold": 0.01},
        {"guiding_method": "OFF", "samples": 90, "roulette": "THROUGHPUT"},  # the last tasks are divided
        {"guiding_method": "OFF", "samples": 24, "roulette": "LEARNED"},
    ],
    ids=["guided", "noise threshold", "denoised threshold", "unguided", "learned roulette"],
)
def test_the_picture_is_one_process_s(changes):
    settings = RenderSettings(threads=1, seed=3, **changes)
    wanted = by_one(settings)
    for count in (1, 3):
        result = by_workers(WorkersHere(count), settings)
        assert is_same(result, wanted)
        assert result.report.sample_count == wanted.report.sample_count
        assert result.report.guiding.lines[1:] == wanted.report.guiding.lines[1:]


@pytest.mark.parametrize("changes", [{"guiding_method": "VMM"}, {"guiding_method": "OFF", "roulette": "THROUGHPUT"}])
def test_what_one_process_has_begun_goes_on_the_same(changes, tmp_path):
    settings = RenderSettings(threads=1, seed=3, samples=40, **changes)
    plan = CheckpointPlan(tmp_path / "x", SceneDigest(SCENE), settings.seed, keeps=True)
    notices = []

    def go_on(session):
        session.load(SCENE)
        session.checkpointing = Checkpointing(replace(plan, resumes=True, keeps=False), notices.append)
        result = session.render(passes=PASSES)
        session.checkpointing.close()
        return result

    begun = Session(replace(settings, deterministic=True))
    begun.load(SCENE)
    begun.checkpointing = Checkpointing(plan, notices.append)
    begun.render(passes=PASSES, samples=16)
    begun.checkpointing.close()
    wanted = go_on(begun)
    result = go_on(ClusterSession(settings, WorkersHere(3)))
    assert is_same(result, wanted) and not notices
    assert result.report.sample_count == wanted.report.sample_count == 40


def test_hair_and_light_below_surfaces_are_one_process_s():
    scene = fur_on_skin()
    settings = RenderSettings(threads=1, seed=3, guiding_method="VMM", samples=24, guiding_trial=False)
    first, other = by_one(settings, scene, keep=True), by_workers(WorkersHere(2), settings, scene, keep=True)
    assert is_same(other, first)
    again = by_workers(WorkersHere(2), settings, scene, start=other.learned)
    assert is_same(again, by_one(settings, scene, start=first.learned))


def strands_that_move():
    """A strand that rises before the corner and gets thicker, while the shutter is open."""
    scene = corner_scene(size=(96, 64))
    keys = np.array([(-0.5, 0.0, 0.3), (0.0, 0.1, 0.5), (0.5, 0.0, 0.3)], np.float32)
    rows = np.array([(0, 1, 0), (1, 2, 0)], np.uint32)
    radii = np.full((2, 3), 0.1, np.float32) * np.array([[1.0], [2.0]], np.float32)
    rounds = Rounds(ROUND, radii[0].copy(), motion_radii=radii)
    moved = np.stack([keys, keys + np.float32(0.2)])
    slots = np.zeros(2, np.int32)
    scene.meshes.append(Mesh("strand", "Strand", keys, rows, None, slots, motion_vertices=moved, rounds=rounds))
    scene.instances.mesh[-1] = len(scene.meshes) - 1
    scene.shutter = (0.0, 1.0)
    return scene


def test_strands_that_move_come_to_workers_whole():
    settings = RenderSettings(threads=1, seed=3, guiding_method="OFF", samples=16)
    wanted = by_one(settings, strands_that_move())
    assert is_same(by_workers(WorkersHere(3), settings, strands_that_move()), wanted)
    still = strands_that_move()
    still.meshes[-1].motion_vertices = still.meshes[-1].rounds.motion_radii = None
    assert not is_same(by_one(settings, still), wanted)


@pytest.mark.slow
@pytest.mark.parametrize(
    "changes",
    [
        {"guiding_method": "AUTO", "samples": 128},  # tries guiding, gives it up, and tries learned roulette
        {"guiding_method": "VMM", "samples": 32, "radiance_cache": "CONVERGING"},
        {"guiding_method": "SDTREE", "samples": 24},
        {"guiding_method": "TABLE_RIS", "samples": 24},
    ],
    ids=["AUTO", "radiance cache", "SD-tree", "table"],
)
def test_the_picture_is_one_process_s_whatever_learns(changes):
    settings = RenderSettings(threads=1, seed=3, **changes)
    assert is_same(by_workers(WorkersHere(3), settings), by_one(settings))


@pytest.mark.slow
def test_networks_are_trained_by_the_coordinator():
    pytest.importorskip("torch")
    settings = RenderSettings(threads=1, seed=3, guiding_method="NASG", samples=16)
    session = ClusterSession(settings, WorkersHere(3))
    notices = [(notice.subject, notice.problem) for notice in session.load(SCENE)]
    assert ("Cluster", "workers train no networks") in notices
    result = session.render(passes=PASSES)
    assert any("snapshots" in line for line in result.report.guiding.lines)
    assert is_same(result, by_one(settings))


def test_what_workers_have_learned_is_kept_and_begun_with():
    settings = RenderSettings(threads=1, seed=3, guiding_method="VMM", samples=24, guiding_trial=False)
    first, other = by_one(settings, keep=True), by_workers(WorkersHere(2), settings, keep=True)
    assert other.learned is not None and other.learned.samples == first.learned.samples
    again = by_workers(WorkersHere(2), settings, start=other.learned)
    assert again.report.guiding.started_from and is_same(again, by_one(settings, start=first.learned))


def test_a_worker_goes_by_what_the_order_names():
    """Whatever it went by before; what is not what the order names is no answer."""
    pool = WorkersHere(1)
    by_workers(pool, RenderSettings(threads=1, seed=3, guiding_method="VMM", samples=15))
    named = {pickle.loads(order).learned: (order, learned) for order, learned in pool.orders}
    assert len(named) == 4  # iterations of 1, 3, 4 and 7 samples
    (first, first_learned), *_, (last, last_learned) = named.values()
    layout = pickle.loads(last).layout

    def radiance(order, learned):
        kind, _, packed, *_ = trace(source_version(), order, pool.scene, learned)
        assert kind == SUMS
        return unpack_traced(packed, layout).sums.radiance

    wanted = radiance(last, last_learned)
    radiance(first, first_learned)
    kind, sentence, *_ = trace(source_version(), last, pool.scene, first_learned)
    assert kind == FAILED and "another digest" in sentence
    assert np.array_equal(radiance(last, last_learned), wanted)
    # Once it has a field it needs no other copy.
    assert np.array_equal(radiance(last, first_learned), wanted)
