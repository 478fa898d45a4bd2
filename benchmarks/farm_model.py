# SPDX-License-Identifier: GPL-3.0-or-later
"""A simulated cluster: workers that trace, and a coordinator that all results have to pass, one after the other.

Simulated are the ranges of `engine.cluster`, two tickets a worker, the link to the coordinator, what each task and byte
costs it, and the wait at the end of each round while it learns. Not simulated are workers that fail, the building of
the scene, and links between workers.
"""

from __future__ import annotations

import heapq
from collections import deque
from dataclasses import dataclass

import numpy as np

from engine.cluster.dispatcher import TICKETS
from engine.cluster.job import MOST_PATHS
from engine.cluster.ranges import tiles_in_range
from engine.guiding.policy.iterations import iteration_lengths
from engine.guiding.policy.rules import RULES
from engine.render.schedule import sample_ranges
from engine.render.tiles import TILE_SIZE

#: Spread of the time that a range takes: standard deviation of its logarithm.
_SPREAD = 0.3


@dataclass(frozen=True)
class Costs:
    """What was measured.

    path_seconds : of a thread, a path
    task_seconds, byte_seconds : of the coordinator's and scheduler's processor, a range and a byte that comes
    ticket_seconds : a range that is handed out, a worker that there is
    pixel_seconds : a pixel that is put on the film, of one task
    learning_seconds : a round
    pixel_bytes : of a pixel's sums
    record_bytes : of what a path records at a vertex
    guidance_bytes : of what is sent out after a round
    """

    path_seconds: float
    task_seconds: float
    byte_seconds: float
    ticket_seconds: float
    pixel_seconds: float
    learning_seconds: float
    pixel_bytes: float
    record_bytes: float
    guidance_bytes: float


@dataclass(frozen=True)
class Frame:
    """What is rendered: size [pixels], samples a pixel, and whether it is guided."""

    width: int
    height: int
    samples: int
    is_guided: bool

    @property
    def tile_count(self) -> int:
        """Tiles."""
        return -(-self.width // TILE_SIZE) * -(-self.height // TILE_SIZE)

    @property
    def rounds(self) -> list[list[int]]:
        """Samples of the tasks of each round; in an unguided render nobody waits between tasks."""
        if self.is_guided:
            return [[length] for length in iteration_lengths(self.samples)]
        return [[count for _, count in sample_ranges(self.samples)]]

    def round_bytes(self, costs: Costs) -> float:
        """Bytes that come in with a task of all tiles."""
        records = RULES.records_per_iteration * costs.record_bytes if self.is_guided else 0.0
        return self.width * self.height * costs.pixel_bytes + records


def simulate(frame: Frame, worker_count: int, threads: int, link: float, costs: Costs) -> float:
    """Time [s] of a render.

    Parameters
    ----------
    threads : int, of each worker
    link : float [bytes / s], to the coordinator
    """
    rng = np.random.default_rng(0)
    now = 0.0
    for lengths in frame.rounds:
        now = _round(frame, lengths, worker_count, threads, link, costs, now, rng)
        if frame.is_guided:
            # Workers fetch it from each other, so that twice as many have it after each turn.
            turns = np.ceil(np.log2(worker_count + 1))
            now += costs.learning_seconds + turns * costs.guidance_bytes / link
    return now


def _round(
    frame: Frame, lengths: list[int], worker_count: int, threads: int, link: float, costs: Costs, start: float,
    rng: np.random.Generator,
) -> float:
    """When the last result is on the film, of a round that begins at `start`."""
    waiting: deque[tuple[int, int]] = deque()
    for samples in lengths:
        seconds = frame.tile_count * TILE_SIZE**2 * samples * costs.path_seconds / threads
        share = tiles_in_range(frame.tile_count, worker_count, seconds)
        share = max(min(share, MOST_PATHS // (TILE_SIZE**2 * samples)), 1)
        for first in range(0, frame.tile_count, share):
            waiting.append((min(share, frame.tile_count - first), samples))
    bytes_per_tile = frame.round_bytes(costs) / frame.tile_count
    free = np.full(worker_count, start)
    link_free = coordinator_free = start
    #: When a result is at the coordinator's door, whose it is, and of how many tiles.
    events: list[tuple[float, int, int]] = []

    def hand_out(worker: int, when: float) -> None:
        if not waiting:
            return
        tiles, samples = waiting.popleft()
        paths = tiles * TILE_SIZE**2 * samples
        # A tile is one thread's.
        turns = -(-tiles // threads) / tiles * threads
        seconds = paths * costs.path_seconds / threads * turns * rng.lognormal(0.0, _SPREAD)
        free[worker] = max(free[worker], when) + seconds
        heapq.heappush(events, (float(free[worker]), worker, tiles))

    for _ in range(TICKETS):
        for worker in range(worker_count):
            coordinator_free += costs.ticket_seconds * worker_count
            hand_out(worker, coordinator_free)
    while events:
        come, worker, tiles = heapq.heappop(events)
        size = tiles * bytes_per_tile
        link_free = max(link_free, come) + size / link
        work = costs.task_seconds + costs.ticket_seconds * worker_count + size * costs.byte_seconds
        work += tiles * TILE_SIZE**2 * costs.pixel_seconds
        coordinator_free = max(coordinator_free, link_free) + work
        hand_out(worker, coordinator_free)
    return coordinator_free
