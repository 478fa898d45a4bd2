# SPDX-License-Identifier: GPL-3.0-or-later
"""What learning takes of the tracing threads' time."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any


class MeteredExecutor(ThreadPoolExecutor):
    """Threads that know what processor time their tasks have taken; parameters as of `ThreadPoolExecutor`."""

    def __init__(self, max_workers: int, thread_name_prefix: str = "") -> None:
        super().__init__(max_workers, thread_name_prefix)
        self._counting = threading.Lock()
        self._seconds = 0.0

    @property
    def seconds(self) -> float:
        """Processor time of all tasks that are done [s]."""
        with self._counting:
            return self._seconds

    def submit(self, fn: Callable[..., Any], /, *args: Any, **kwargs: Any) -> Future[Any]:
        return super().submit(self._meter, fn, args, kwargs)

    def _meter(self, fn: Callable[..., Any], args: tuple[Any, ...], kwargs: dict[str, Any]) -> Any:
        began = time.thread_time()
        try:
            return fn(*args, **kwargs)
        finally:
            with self._counting:
                self._seconds += time.thread_time() - began


class LearningTime:
    """What a learning takes of the tracing threads' time.

    Others trace while one thread learns (`engine.render.bridge`): it takes the time of its processor and of those that
    help it. Where nobody does so, all threads wait for it.

    Parameters
    ----------
    executor : MeteredExecutor
        What helps the thread that learns.
    waiting_count : int
        Threads that wait meanwhile; 0: they trace.
    """

    def __init__(self, executor: MeteredExecutor, waiting_count: int) -> None:
        self._executor, self._waiting_count = executor, waiting_count
        self._began = 0.0

    def _now(self) -> float:
        if self._waiting_count:
            return time.perf_counter() * self._waiting_count
        return time.thread_time() + self._executor.seconds

    def begin(self) -> None:
        """The calling thread begins to learn."""
        self._began = self._now()

    def end(self) -> float:
        """It has learned; returns what that took [s]."""
        return self._now() - self._began
