# SPDX-License-Identifier: GPL-3.0-or-later
"""A session whose samples are taken by a cluster's workers."""

from __future__ import annotations

import pickle
import weakref
from collections.abc import Callable
from dataclasses import replace

from engine.builder.scene import Scene
from engine.cluster.job import PATIENCE, ClusterJob
from engine.cluster.pool import Pool
from engine.cluster.work import digest_of
from engine.guiding.policy.guidance import Guidance
from engine.render.film import Film
from engine.render.render_loop import RenderLoop
from engine.render.report import Progress
from engine.render.request import RenderRequest
from engine.render.session import Session
from engine.scene.description import Camera, Frame, Notice, SceneDescription
from engine.settings import RenderSettings


class ClusterSession(Session):
    """As `Session`, but for who traces: see `engine.render.session.Session`.

    The scene is built here too, for what has to be said of it before it is sent. What guides is learned here, from what
    all workers have recorded, so that it does not depend on who took part.

    Parameters
    ----------
    settings : RenderSettings
    pool : Pool
    patience : float
        Least time [s] that a range may take before others are asked for it as well.
    """

    _on_cluster = True

    def __init__(self, settings: RenderSettings, pool: Pool, patience: float = PATIENCE) -> None:
        super().__init__(settings)
        self._pool = pool
        self._patience = patience
        self._digest = ""

    def load(
        self,
        description: SceneDescription,
        *,
        on_progress: Callable[[Progress], None] | None = None,
        should_cancel: Callable[[], bool] | None = None,
        keeps_meshes: bool = True,
    ) -> list[Notice]:
        """Build the scene, and have the cluster hold it; as `Session.load`, but that meshes are always kept.

        Raises
        ------
        ClusterError
            If there is no cluster any more.
        """
        notices = super().load(description, on_progress=on_progress, should_cancel=should_cancel)
        scene = pickle.dumps(description, protocol=5)
        self._digest = digest_of(scene)
        self._pool.hold(self._digest, scene)
        return [*notices, *_left_out(self.settings)]

    def look(self, camera: Camera, frame: Frame) -> None:
        """As `Session.look`; the scene is sent anew."""
        if self.scene is None:
            raise RuntimeError("load a scene before looking at it")
        self.load(replace(self.scene.description, camera=camera, frame=frame))

    def _job(
        self, scene: Scene, request: RenderRequest, film: Film, _ray_observer: Callable[..., None] | None
    ) -> ClusterJob:
        jobs: weakref.WeakSet[ClusterJob] = weakref.WeakSet()

        def follow(guidance: Guidance, arm: int) -> None:
            # A job that is over is freed with its loop: neither waits for the garbage collector.
            for job in jobs:
                job.follow(guidance, arm)

        tracer = self._take_tracer(scene, request.settings, film.layout)
        loop = RenderLoop(request, film, self.thread_count, follow, tracer.light_clusters)
        job = ClusterJob(self._pool, self._digest, loop, self._patience)
        jobs.add(job)
        return job


def _left_out(settings: RenderSettings) -> list[Notice]:
    """What a cluster does otherwise than one machine."""
    if not settings.trains_network:
        return []
    found = [Notice("Cluster", "workers train no networks", "this machine does between iterations, and workers wait")]
    if settings.network_backend != "KERNEL":
        found.append(Notice("Cluster", "workers do not ask onnxruntime", "the kernel computes the radiance network"))
    return found
