# SPDX-License-Identifier: GPL-3.0-or-later
"""What the coordinator does about workers that are gone, hung, of another version, or twice as eager as asked.

The workers are simulated, with a clock of their own. Every path brings a one, so that the film shows what was counted.
"""

from __future__ import annotations

import heapq
import pickle

import numpy as np
import pytest

from engine.cluster.collector import Collector
from engine.cluster.job import ClusterJob
from engine.cluster.pool import ClusterError
from engine.cluster.ranges import plan_ranges
from engine.cluster.version import source_version
from engine.cluster.work import REFUSED, SUMS, Answer, trace
from engine.render.film import Film
from engine.scene.description import Frame
from engine.settings import RenderSettings
from engine.state.film import allocate_tile

FRAME = Frame(96, 64, (0, 0, 96, 64))
SAMPLES = 200


class SimulatedPool:
    """Workers with a speed each [paths per second], 0: hung; those with a time to die are gone from then on."""

    def __init__(self, speeds, dies=None, refuses=()):
        self.now = 0.0
        self.begun = []
        self._speeds, self._dies, self._refuses = speeds, dies or {}, refuses
        self._free = dict.fromkeys(speeds, 0.0)
        self._events = []
        self._cancelled = set()

    def hold(self, digest, scene):
        pass

    def workers(self):
        return frozenset(name for name in self._speeds if self.now < self._dies.get(name, np.inf))

    def submit(self, ticket, worker, order):
        item = pickle.loads(order).range
        self.begun.append((worker, item.number))
        speed = self._speeds[worker]
        if speed == 0.0:
            return
        self._free[worker] = done = max(self._free[worker], self.now) + item.path_count / speed
        if done >= self._dies.get(worker, np.inf):
            return
        answer = Answer(REFUSED, "another version") if worker in self._refuses else Answer(SUMS, "", tuple(ones(item)))
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


def ones(item):
    """Sums of a range whose samples are all one."""
    x0, y0, x1, y1 = item.region
    tile = allocate_tile((x1 - x0) * (y1 - y0), 3)
    tile.radiance[:] = item.count
    tile.count[:] = item.count
    return tile


def run(pool, samples=SAMPLES, limit=10000.0):
    """A whole render; the film and the job."""
    film = Film(96, 64)
    job = ClusterJob(pool, "scene", RenderSettings(samples=samples, guiding_method="OFF"), film, FRAME, samples, 1.0)
    job.start()
    while not job.wait(1.0):
        assert pool.now < limit, "the render does not end"
    job.join()
    return film, job


def is_whole(film, samples=SAMPLES):
    return (film.sums.count == samples).all() and (film.sums.radiance == samples).all()


def test_ranges_cover_each_sample_of_each_pixel_once():
    for count in (1, 2, 5, 100):
        covered = np.zeros((64, 96, SAMPLES), int)
        for item in plan_ranges(FRAME, SAMPLES, count):
            x0, y0, x1, y1 = item.region
            covered[y0:y1, x0:x1, item.first : item.first + item.count] += 1
        assert (covered == 1).all()


def test_a_range_that_comes_twice_counts_once():
    film = Film(96, 64)
    ranges = plan_ranges(FRAME, SAMPLES, 2)
    collector = Collector(film, FRAME.region, ranges)
    for item in reversed(ranges):
        assert collector.take(item.number, ones(item))
        assert not collector.take(item.number, ones(item))
    assert collector.is_complete and is_whole(film)


def test_four_workers_share_the_work():
    pool = SimulatedPool(dict.fromkeys("abcd", 10000.0))
    film, job = run(pool)
    assert is_whole(film) and not job.notices
    assert {worker for worker, _ in pool.begun} == set("abcd")


def test_ranges_of_a_lost_worker_are_done_again():
    film, job = run(SimulatedPool(dict.fromkeys("abcd", 10000.0), dies={"b": 10.0}))
    assert is_whole(film)
    assert [(notice.subject, notice.problem) for notice in job.notices] == [("Cluster, worker b", "is gone")]


def test_ranges_of_a_hung_worker_are_done_by_others():
    film, job = run(SimulatedPool({"a": 1e4, "b": 0.0, "c": 1e4, "d": 1e4}), limit=300.0)
    assert is_whole(film)
    assert "hangs" in job.notices[0].problem and job.notices[0].subject == "Cluster, worker b"


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
