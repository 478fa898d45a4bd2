# SPDX-License-Identifier: GPL-3.0-or-later
"""The thread that takes what a worker says of a training."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable

from engine.guiding.neural.trainer.channel import Channel
from engine.guiding.neural.trainer.status import WorkerNews
from engine.processes.child import Child


class Reader(threading.Thread):
    """Takes a worker's messages until it is through with a training, or gone.

    Parameters
    ----------
    child : Child
    before : Thread or None
        Takes those of the training before; this one begins when that has ended.
    news : WorkerNews
    die : callable (str) -> None
        Hears why no more will come, but not of a training that the worker was told to leave.
    """

    def __init__(
        self, child: Child, before: threading.Thread | None, news: WorkerNews, die: Callable[[str], None]
    ) -> None:
        super().__init__(name="training", daemon=True)
        self._child, self._before, self._news, self._die = child, before, news, die
        self._left_behind: Channel | None = None

    def close_at_end(self, channel: Channel) -> None:
        """Close a channel once the worker is through; called before it is told to leave, under the lock of the news.

        One that is starting comes to this training, and its memory, only to leave it.
        """
        self._left_behind = channel

    def run(self) -> None:
        if self._before is not None:
            self._before.join()
        self._read()
        if self._left_behind is not None:
            self._left_behind.close()

    def _read(self) -> None:
        stream = self._child.process.stdout
        assert stream is not None
        try:
            for line in stream:
                message = json.loads(line)
                if message["kind"] == "left":
                    return
                self._news.take(message)
        except (OSError, ValueError, KeyError, TypeError) as error:
            self._die(f"the training worker answered nonsense: {error}")
            return
        self._die(f"the training worker {self._child.reason(self._child.process.wait())}")
