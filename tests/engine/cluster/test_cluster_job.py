# SPDX-License-Identifier: GPL-3.0-or-later
"""What the coordinator does about workers that are gone, hung, of another version, or twice as eager as asked.

The workers are simulated, with a clock of their own. Every path brings a one, so that the film shows what was counted.
"""

from __future__ import annotations

import heapq
import pickle

import numpy as np
import pytest

from engine.cluster.job import ClusterJob
from engine.cluster.pool import ClusterError
from engine.cluster.ranges import RANGE_SECONDS, RANGES_PER_WORKER, RangeCutter, tiles_in_range
from engine.cluster.work import REFUSED, SUMS, Answer, pack_traced, trace
from engine.render.film import Film
from engine.render.render_loop import RenderLoop
from engine.render.request import RenderRequest
from engine.render.tiles import FrameTiles
from engine.render.traced import TracedTiles
from engine.runtime.source_version import source_version
from engine.scene.description import Frame
from engine.settings import RenderSettings
from engine.state.film import allocate_tile
from engine.state.unit import UnitCosts

FRAME = Frame(96, 64, (0, 0, 96, 64))
SAMPLES = 200


class SimulatedPool:
    """Workers with a speed each [paths per second], 0: hung; those with a time to die are gone from then on.

    Those who are away from one time to another do nothing meanwhile, and forget what they had.
    """

    def __init__(self, speeds, dies=None, refuses=(), copies=1, away=None):
        self.now = 0.0
        self.begun = []
        self._speeds, self._dies, self._refuses = speeds, dies or {}, refuses
        self._copies = copies
        self._away = away or {}
        self._free = dict.fromkeys(speeds, 0.0)
        self._events = []
        self._cancelled = set()

    def hold(self, scene, blob):
        pass

    def hold_learned(self, learned, blob):
        pass

    def workers(self):
        alive = (name for name in self._speeds if self.now < self._dies.get(name, np.inf))
        return frozenset(name for name in alive if not self._is_away(name, self.now))

    def _is_away(self, name, now):
        begin, end = self._away.get(name, (np.inf, np.inf))
        return begin <= now < end

    def submit(self, ticket, worker, order):
        wanted = pickle.loads(order)
        self.begun.append((worker, wanted.tiles, wanted.arm_samples))
        speed = self._speeds[worker]
        if speed == 0.0:
            return
        sums = ones(wanted)
        self._free[worker] = done = max(self._free[worker], self.now) + sums.sums.count.sum() / speed
        if done >= self._dies.get(worker, np.inf) or self._is_away(worker, done):
            return
        answer = Answer(SUMS, "", pack_traced(sums))
        if worker in self._refuses:
            answer = Answer(REFUSED, "another version")
        for _ in range(self._copies):
            heapq.heappush(self._events, (done, ticket, answer))

    def take(self, seconds):
        while self._events and self._events[0][0] <= self.now + seconds:
            done, ticket, answer = heapq.heappop(self._events)
            if ticket not in self._cancelled:
                self.now = max(self.now, done)
                return ticket, answer
        self.now += seconds
        return None

    def cancel(self, tickets):
        self._cancelled.update(tickets)

    def close(self):
        pass


def ones(order):
    """What a range brings whose samples are all one."""
    tiles = FrameTiles(FRAME)
    pixel_count = sum(len(tiles[tile][0]) for tile in order.tiles)
    tile = allocate_tile(pixel_count, 3)
    tile.radiance[:] = order.arm_samples.sample_count
    tile.count[:] = order.arm_samples.sample_count
    return TracedTiles(tile, [UnitCosts()] * len(order.tiles), None)


def plain_loop(film, samples=SAMPLES):
    """Loop of an unguided render."""
    settings = RenderSettings(samples=samples, guiding_method="OFF", roulette="THROUGHPUT")
    return RenderLoop(RenderRequest(FRAME, settings), film, 1, lambda guidance: None)


def run(pool, samples=SAMPLES, limit=10000.0):
    """A whole render; the film and the job."""
    film = Film(96, 64)
    job = ClusterJob(pool, "scene", plain_loop(film, samples), 1.0)
    job.start()
    while not job.wait(1.0):
        assert pool.now < limit, "the render does not end"
    job.join()
    return film, job


def is_whole(film, samples=SAMPLES):
    return (film.sums.count == samples).all() and (film.sums.radiance == samples).all()


def test_ranges_cover_each_sample_of_each_tile_once_and_in_order():
    for tile_count, most_paths in ((1, 1), (2, 1 << 20), (100, 40000), (100, 1 << 20)):
        film = Film(96, 64)
        loop = plain_loop(film)
        cutter = RangeCutter(loop)
        reached = np.zeros(6, int)
        numbers = []
        while cutter.has_task:
            item = cutter.cut(tile_count, most_paths)
            numbers.append(item.number)
            assert len(item.tasks) <= tile_count and (len(item.tasks) == 1 or item.path_count <= most_paths)
            for task in item.tasks:
                assert task.arm_samples[:2] == item.tasks[0].arm_samples[:2]
                assert task.arm_samples.first_sample == reached[task.tile]
                reached[task.tile] += task.arm_samples.sample_count
                loop.finish(task)
        assert (reached == SAMPLES).all() and len(set(numbers)) == len(numbers)


def test_there_are_as_many_ranges_as_pay():
    """By counting up: a pass of 50 s, divided in whole tiles among workers without end."""
    tiles, seconds = 10_000, 50.0
    counts = np.arange(1, tiles)
    best = counts[np.argmin(counts * RANGE_SECONDS + seconds / counts)]
    assert tiles / tiles_in_range(tiles, 10_000, seconds) == pytest.approx(best, rel=0.02)
    assert tiles_in_range(tiles, 4, seconds) == tiles // (4 * RANGES_PER_WORKER)
    assert tiles_in_range(tiles, 10_000, None) == 1 and tiles_in_range(0, 0, 0.0) == 1


def test_a_range_that_comes_twice_counts_once():
    film, job = run(SimulatedPool(dict.fromkeys("abcd", 10000.0), copies=2))
    assert is_whole(film) and not job.notices


def test_four_workers_share_the_work():
    pool = SimulatedPool(dict.fromkeys("abcd", 10000.0))
    film, job = run(pool)
    assert is_whole(film) and not job.notices
    assert {worker for worker, _, _ in pool.begun} == set("abcd")


def test_ranges_of_a_lost_worker_are_done_again():
    film, job = run(SimulatedPool(dict.fromkeys("abcd", 10000.0), dies={"b": 10.0}))
    assert is_whole(film)
    assert [(notice.subject, notice.problem) for notice in job.notices] == [("Cluster, worker b", "is gone")]


def test_ranges_of_a_hung_worker_are_done_by_others():
    film, job = run(SimulatedPool({"a": 1e4, "b": 0.0, "c": 1e4, "d": 1e4}), limit=300.0)
    assert is_whole(film)
    assert "hangs" in job.notices[0].problem and job.notices[0].subject == "Cluster, worker b"


def test_whoever_comes_back_or_comes_new_goes_on_where_all_others_are_gone():
    """One is away, the other dies meanwhile; the first comes back; and another one instead of it."""
    back = SimulatedPool(dict.fromkeys("ab", 1e4), dies={"b": 10.0}, away={"a": (5.0, 40.0)})
    film, job = run(back, limit=300.0)
    assert is_whole(film) and len(job.notices) == 2
    new = SimulatedPool(dict.fromkeys("abc", 1e4), dies={"a": 5.0, "b": 10.0}, away={"c": (0.0, 40.0)})
    film, job = run(new, limit=300.0)
    assert is_whole(film) and {worker for worker, _, _ in new.begun} == set("abc")


def test_a_slow_worker_does_not_keep_the_others_waiting():
    even = SimulatedPool(dict.fromkeys("abcd", 1e4))
    run(even)
    pool = SimulatedPool({"a": 1e3, "b": 1e4, "c": 1e4, "d": 1e4})
    film, _ = run(pool)
    assert is_whole(film)
    # Three do the work of four in four thirds of the time; what the slow one holds back may double that.
    assert pool.now < even.now * 4.0 / 3.0 * 2.0


def test_a_worker_of_another_version_is_refused():
    film, job = run(SimulatedPool(dict.fromkeys("abcd", 1e4), refuses=("c",)))
    assert is_whole(film)
    assert [notice.problem for notice in job.notices] == ["is refused: another version"]
    with pytest.raises(ClusterError, match=r"no worker is left.*another version"):
        run(SimulatedPool({"a": 1e4}, refuses=("a",)))


def test_workers_tell_their_version():
    kind, sentence = trace("another", b"", b"")
    assert kind == REFUSED and "another" in sentence and source_version() in sentence
