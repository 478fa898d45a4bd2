# SPDX-License-Identifier: GPL-3.0-or-later
"""Watches a render from its start to its end: tells how it goes, shows pictures, keeps checkpoints, and stops it."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from engine.render.checkpointing import Checkpointing
from engine.render.film import Images
from engine.render.job import AnyJob
from engine.render.pace import Pace
from engine.render.report import Progress


def watch(
    job: AnyJob, images: Callable[[], Images], on_progress: Callable[[Progress], None] | None,
    on_image: Callable[[Images], None] | None, should_cancel: Callable[[], bool], pace: Pace,
    checkpointing: Checkpointing | None,
) -> None:
    """Start a job and stay until it is over, and its threads are.

    Parameters
    ----------
    job : AnyJob
    images : callable () -> Images
        Makes what `on_image` gets.
    on_progress, on_image : callable, optional
    should_cancel : callable () -> bool
    pace : Pace
        When there are images, and how often the others are called.
    checkpointing : Checkpointing, optional
    """
    try:
        _follow(job, images, on_progress, on_image, should_cancel, pace, checkpointing)
    except BaseException:
        job.stop()
        job.join()
        if checkpointing is not None:
            checkpointing.close()
        if on_image is not None and job.has_paths:
            # What there is by now may be the only picture that there will be.
            with contextlib.suppress(Exception):
                on_image(images())
        raise
    finally:
        job.join()
    if checkpointing is not None:
        checkpointing.end(job, is_whole=job.ended_by != "CANCEL")


def _follow(
    job: AnyJob, images: Callable[[], Images], on_progress: Callable[[Progress], None] | None,
    on_image: Callable[[Images], None] | None, should_cancel: Callable[[], bool], pace: Pace,
    checkpointing: Checkpointing | None,
) -> None:
    started = time.perf_counter()
    image_count = 0
    next_image = pace.due(0, 0.0)
    job.start()
    while not job.wait(pace.poll_seconds):
        elapsed = time.perf_counter() - started
        if should_cancel():
            job.ended_by = "CANCEL"
            job.stop()
            if job.is_preparing:
                break
            continue
        if on_progress is not None:
            on_progress(job.progress())
        if checkpointing is not None:
            checkpointing.poll(job)
        if on_image is not None and job.has_paths and elapsed >= next_image:
            on_image(images())
            image_count += 1
            next_image = pace.due(image_count, time.perf_counter() - started)
