# SPDX-License-Identifier: GPL-3.0-or-later
"""How fast bare Embree is on the very rays of a render: record them, then trace them again with nothing around."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from engine.accel import MASK_SHADOW_OPAQUE, RayScratch, end_on, start_on, trace_closest_from, trace_occluded_from
from engine.builder.scene import Scene
from engine.runtime.jit import kernel
from engine.state.lanes import RAY_DIFFUSE, RAY_GLOSSY, RAY_TRANSMIT
from engine.state.lights import EMITTER_INSTANCE, EMITTER_TRIANGLE


@kernel
def _replay_closest(scene, ray, bits, address, geometry, origin, direction, near, far, mask, own, light):
    hits = 0
    for i in range(far.shape[0]):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        start_on(bits, geometry, own[i, 0], own[i, 1])
        if trace_closest_from(scene, ray, bits, address, o, d, near[i], far[i], 0.0, mask[i]):
            hits += 1
    return hits


@kernel
def _replay_occluded(scene, ray, bits, address, geometry, origin, direction, near, far, mask, own, light):
    hits = 0
    for i in range(far.shape[0]):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        start_on(bits, geometry, own[i, 0], own[i, 1])
        end_on(bits, geometry, light[i, 0], light[i, 1])
        if trace_occluded_from(scene, ray, bits, address, o, d, near[i], far[i], 0.0, mask[i]):
            hits += 1
    return hits


@dataclass(frozen=True)
class _Batch:
    """Rays that were traced together, K of them, as Embree is asked for them.

    origin, direction : float32 (K, 3); near, far : float32 (K,); mask : uint32 (K,)
    own : int32 (K, 2), instance and triangle that a ray starts on, -1 = none
    emitter : int32 (K,), that it ends on, -1 = none
    """

    is_shadow: bool
    origin: np.ndarray
    direction: np.ndarray
    near: np.ndarray
    far: np.ndarray
    mask: np.ndarray
    own: np.ndarray
    emitter: np.ndarray


@dataclass
class RayRecorder:
    """Copies rays as they are traced; give its `observe` to `Session.render(ray_observer=...)`, one thread only.

    Stops at `limit` rays, so that a long render does not fill memory.
    """

    limit: int = 4_000_000
    batches: list[_Batch] = field(default_factory=list)
    count: int = 0

    def observe(self, kind: str, first, second, count: int) -> None:
        """`Tracer.ray_observer`: paths and lanes for closest hits, shadow rays and paths for shadows."""
        if self.count >= self.limit or count == 0:
            return
        if kind == "closest":
            lanes = second[:count]
            visibility = first.flags[lanes] & 31
            transmitted = (visibility & RAY_TRANSMIT) != 0
            mask = np.where(transmitted, visibility & ~(RAY_DIFFUSE | RAY_GLOSSY), visibility)
            own = np.stack([first.hit_instance[lanes], first.hit_triangle[lanes]], axis=1)
            near, far, emitter = first.near[lanes], first.hit_distance[lanes], np.full(count, -1, np.int32)
        else:
            lanes, of_path = slice(0, count), first.lane[:count]
            mask = np.full(count, MASK_SHADOW_OPAQUE)
            instance = np.where(first.starts_on[:count] != 0, second.hit_instance[of_path], np.int32(-1))
            own = np.stack([instance, second.hit_triangle[of_path]], axis=1)
            near, far = np.zeros(count, np.float32), first.distance[:count].copy()
            emitter = first.emitter[:count].copy()
        self.batches.append(
            _Batch(
                kind == "shadow", first.origin[lanes].copy(), first.direction[lanes].copy(), near, far,
                mask.astype(np.uint32), own, emitter,
            )
        )
        self.count += count

    def replay(self, scene: Scene, threads: int = 1) -> float:
        """Seconds that `threads` threads take for all recorded rays, in the recorded order, batches dealt in turn."""
        scratches = [RayScratch() for _ in range(threads)]
        ends = scene.lights.emitters[:, [EMITTER_INSTANCE, EMITTER_TRIANGLE]]
        # One more for rays that end on none.
        ends = np.concatenate([ends, np.full((1, 2), -1, np.int32)])

        def trace(s: RayScratch, rays: _Batch, count: int) -> None:
            search = _replay_occluded if rays.is_shadow else _replay_closest
            search(
                scene.accelerator.handle, s.ray, s.bits, s.address, scene.geometry, rays.origin[:count],
                rays.direction[:count], rays.near[:count], rays.far[:count], rays.mask[:count], rays.own[:count],
                ends[rays.emitter[:count]],
            )

        def run(thread: int) -> None:
            for rays in self.batches[thread::threads]:
                trace(scratches[thread], rays, len(rays.far))

        for rays in self.batches[:2]:  # load the kernels outside the clock
            trace(scratches[0], rays, 0)
        start = time.perf_counter()
        with ThreadPoolExecutor(threads) as pool:
            list(pool.map(run, range(threads)))
        return time.perf_counter() - start
