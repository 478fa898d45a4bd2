# SPDX-License-Identifier: GPL-3.0-or-later
"""A session whose samples are taken by a cluster's workers."""

from __future__ import annotations

import hashlib
import pickle
from collections.abc import Callable
from dataclasses import replace

from engine.builder.scene import Scene
from engine.cluster.job import PATIENCE, ClusterJob
from engine.cluster.pool import Pool
from engine.guiding.models.record_sink import RecordSink
from engine.guiding.models.source_model import TrainedSource
from engine.guiding.saved.learned import LearnedField
from engine.render.film import Film
from engine.render.report import Progress
from engine.render.session import Session
from engine.scene.description import Camera, Frame, Notice, SceneDescription
from engine.settings import RenderSettings

_SUBJECT = "Cluster"


class ClusterSession(Session):
    """As `Session`, but for who traces: see `engine.render.session.Session`.

    The scene is built here too, for what has to be said of it before it is sent.

    Parameters
    ----------
    settings : RenderSettings
        What is learned while rendering is left out, and `load` says so.
    pool : Pool
    patience : float
        Least time [s] that a range may take before others are asked for it as well.
    """

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
        asked = self.settings
        self.settings = without_learning(asked)
        notices = super().load(description, on_progress=on_progress, should_cancel=should_cancel)
        scene = pickle.dumps(description, protocol=5)
        self._digest = hashlib.blake2b(scene, digest_size=16).hexdigest()
        self._pool.hold(self._digest, scene)
        return [*notices, *left_out(asked)]

    def look(self, camera: Camera, frame: Frame) -> None:
        """As `Session.look`; the scene is sent anew."""
        if self.scene is None:
            raise RuntimeError("load a scene before looking at it")
        self.load(replace(self.scene.description, camera=camera, frame=frame))

    def _job(
        self, scene: Scene, settings: RenderSettings, film: Film, _ray_observer: Callable[..., None] | None,
        _source: TrainedSource | None, _sink: RecordSink | None, _start: LearnedField | None, _keep: bool,
        samples: int | None,
    ) -> ClusterJob:
        count = settings.samples if samples is None else min(samples, settings.samples)
        frame = scene.description.frame
        return ClusterJob(self._pool, self._digest, settings, film, frame, count, self._patience)


def without_learning(settings: RenderSettings) -> RenderSettings:
    """Settings by which ranges of samples know nothing of each other."""
    return replace(
        settings, guiding_method="OFF", radiance_cache="OFF", roulette="THROUGHPUT", light_selection="TREE",
        use_adaptive_sampling=False,
    )


def left_out(settings: RenderSettings) -> list[Notice]:
    """What `without_learning` leaves out of settings."""
    found = []
    if settings.is_guided:
        found.append(Notice(_SUBJECT, "workers do not share what they learn yet", "the frame is rendered unguided"))
    if settings.radiance_cache != "OFF":
        found.append(Notice(_SUBJECT, "workers share no radiance cache", "paths find all light themselves"))
    if settings.roulette == "LEARNED":
        found.append(Notice(_SUBJECT, "workers share no learned roulette", "it goes by the throughput"))
    if settings.light_selection == "LEARNED":
        found.append(Notice(_SUBJECT, "workers do not share which lights they see", "the light tree chooses"))
    if settings.use_adaptive_sampling:
        found.append(Notice(_SUBJECT, "no worker sees the whole noise", "every pixel gets all samples"))
    return found
