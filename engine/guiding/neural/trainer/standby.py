# SPDX-License-Identifier: GPL-3.0-or-later
"""The worker that is not training: started before there is anything to train, or kept from the render before.

Importing torch and loading the kernels of training takes seconds. A render that will train a network says so before its
scene is exported (`stand_by`). Whoever starts to train first takes the process (`take`), and gives it back when the
training is over (`keep`): for the next frame, or the next F12. One at most stands by. It goes when it has been idle for
long, and when the renderer goes.
"""

from __future__ import annotations

import atexit
import contextlib
import os
import sys
import threading
import time
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from engine.processes.child import ENTRY, Child
from engine.processes.memory import HAS_UNNAMED_FILES, SharedMemory

#: What workers run.
SERVICE = "guiding.neural.worker.process"
#: Time without training after which a worker ends itself [s].
IDLE_SECONDS = 300.0
#: Share of it after which the renderer no longer counts on the worker.
_COUNTED_ON = 0.95
#: Time in which a worker that was given back is through with what it was doing [s].
LEAVE_SECONDS = 2.0
#: Whether a process that runs already can open the renderer's memory (`SharedMemory.address_for_others`).
CAN_STAND_BY = os.path.isdir("/proc/self/fd") or not HAS_UNNAMED_FILES


def launch(
    interpreter: str, config: dict[str, Any], *, thread_count: int = 1, memories: Collection[SharedMemory] = (),
    script: Path = ENTRY,
) -> Child:
    """Start a worker; arguments as for `Child`.

    Raises
    ------
    OSError
        If it cannot be started.
    """
    # Threads that wait for work must not burn the renderer's processors.
    environment = {"OMP_NUM_THREADS": str(thread_count), "OMP_WAIT_POLICY": "PASSIVE", "KMP_BLOCKTIME": "0"}
    config = config | {"idle_seconds": IDLE_SECONDS}
    return Child(interpreter, SERVICE, config, memories=memories, environment=environment, script=script)


@dataclass
class Standing:
    """A worker that stands by.

    reader : Thread or None, what takes its answers until it is through with the training before; None: there was none
    since : float, when it was last heard of or written to [s]
    is_starting : bool, whether it had not begun with the training before when it was given back
    """

    worker: Child
    reader: threading.Thread | None
    since: float
    is_starting: bool = False

    @property
    def is_well(self) -> bool:
        """Whether it is there, and will be for a while."""
        return self.worker.process.poll() is None and time.monotonic() - self.since < _COUNTED_ON * IDLE_SECONDS

    @property
    def is_through(self) -> bool:
        """Whether it is done with the training before, or will be once it has started; waits for the former a little.
        """
        if self.reader is not None and not self.is_starting:
            self.reader.join(timeout=LEAVE_SECONDS)
        return self.reader is None or self.is_starting or not self.reader.is_alive()

    def end(self) -> None:
        """End it without waiting for what it is doing: it has nothing to lose."""
        self.worker.close(is_patient=False)
        if self.reader is not None:
            self.reader.join()
        self.worker.release()


_lock = threading.Lock()
_standing: Standing | None = None


def stand_by(device: str = "AUTO") -> None:
    """Have a worker stand by, if the system allows it; returns at once and never raises.

    Parameters
    ----------
    device : str
        What it gets ready on, as `TrainingSettings` has it.
    """
    global _standing
    with _lock:
        if not CAN_STAND_BY:
            return
        if _standing is not None and _standing.is_well:
            _standing.worker.send(kind="stay")
            _standing.since = time.monotonic()
            return
        if _standing is not None:
            _standing.end()
            _standing = None
        # Without one, training starts its own, and says why where that fails too.
        with contextlib.suppress(OSError):
            _standing = Standing(launch(sys.executable, {"stands_by": True, "device": device}), None, time.monotonic())


def take(interpreter: str) -> Standing | None:
    """The worker that stands by, if it is well and runs under this Python; nobody else gets it.

    Its answers are the taker's from when its reader has ended.
    """
    global _standing
    with _lock:
        if interpreter != sys.executable or _standing is None:
            return None
        standing, _standing = _standing, None
        if standing.is_through and standing.is_well:
            return standing
        standing.end()
        return None


def keep(worker: Child, reader: threading.Thread, *, is_starting: bool) -> None:
    """Take a worker back that has been told to leave its training; returns at once.

    Parameters
    ----------
    worker : Child
        The process, which runs this one's Python.
    reader : Thread
        Reads the worker's answers, and ends with the one that says that it has left.
    is_starting : bool
        Whether it has not begun with that training. Then whoever takes it waits for it as for a new one.
    """
    global _standing
    given_back = Standing(worker, reader, time.monotonic(), is_starting)
    with _lock:
        if _standing is not None and _standing.is_well:
            given_back.end()
            return
        before, _standing = _standing, given_back
    if before is not None:
        before.end()


def dismiss() -> None:
    """End the worker that stands by."""
    global _standing
    with _lock:
        standing, _standing = _standing, None
    if standing is not None:
        standing.end()


atexit.register(dismiss)
