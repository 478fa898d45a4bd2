# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast bare Embree is on the very rays of a render: record them, then trace them again with nothing around."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from engine.accel.masks import MASK_SHADOW_OPAQUE
from engine.accel.rays import trace_closest, trace_occluded
from engine.accel.scratch import RayScratch
from engine.builder.scene import Scene
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT


@kernel
def _replay_closest(scene, ray, bits, address, origin, direction, far, mask):
    hits = 0
    for i in range(far.shape[0]):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        if trace_closest(scene, ray, bits, address, o, d, 0.0, far[i], 0.0, mask[i]):
            hits += 1
    return hits


@kernel
def _replay_occluded(scene, ray, bits, address, origin, direction, far, mask):
    hits = 0
    for i in range(far.shape[0]):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        if trace_occluded(scene, ray, bits, address, o, d, 0.0, far[i], 0.0, mask[i]):
            hits += 1
    return hits


@dataclass
class RayRecorder:
    """Copies rays as they are traced; give its `observe` to `Session.render(ray_observer=...)`, one thread only.

    Stops at `limit` rays, so that a long render does not fill memory.
    """

    limit: int = 4_000_000
    batches: list[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)
    count: int = 0

    def observe(self, kind: str, first, second, count: int) -> None:
        """`Tracer.ray_observer`: paths and lanes for closest hits, shadow rays and paths for shadows."""
        if self.count >= self.limit or count == 0:
            return
        if kind == "closest":
            lanes = second[:count]
            visibility = first.flags[lanes] & 31
            transmitted = (visibility & RAY_TRANSMIT) != 0
            visibility = np.where(transmitted, visibility & ~(RAY_DIFFUSE | RAY_GLOSSY), visibility)
            batch = (first.origin[lanes], first.direction[lanes], first.hit_distance[lanes], visibility)
        else:
            batch = (
                first.origin[:count].copy(),
                first.direction[:count].copy(),
                first.distance[:count].copy(),
                np.full(count, MASK_SHADOW_OPAQUE),
            )
        self.batches.append((kind, batch[0], batch[1], batch[2], batch[3].astype(np.uint32)))
        self.count += count

    def replay(self, scene: Scene, threads: int = 1) -> float:
        """Seconds that `threads` threads take for all recorded rays, in the recorded order, batches dealt in turn."""
        scratches = [RayScratch() for _ in range(threads)]

        def run(thread: int) -> None:
            s = scratches[thread]
            for kind, origin, direction, far, mask in self.batches[thread::threads]:
                trace = _replay_closest if kind == "closest" else _replay_occluded
                trace(scene.accelerator.handle, s.ray, s.bits, s.address, origin, direction, far, mask)

        nothing = (np.zeros((0, 3), np.float32), np.zeros((0, 3), np.float32), np.zeros(0, np.float32))
        for trace in (_replay_closest, _replay_occluded):  # load the kernels outside the clock
            s = scratches[0]
            trace(scene.accelerator.handle, s.ray, s.bits, s.address, *nothing, np.zeros(0, np.uint32))
        start = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(threads)))
        return time.perf_counter() - start
