# SPDX-License-Identifier: GPL-3.0-or-later
"""A worker that stands by: started before there is anything to train, it is ready by the time there is.

Importing torch and loading the kernels of training takes seconds. A render that will train a network says so before its
scene is exported (`stand_by`), and whoever starts to train first takes the process (`take`). One at most stands by; it
goes when the renderer goes.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import IO, Any, NamedTuple

#: The worker's entry, and what its package is called here.
SCRIPT = Path(__file__).resolve().parents[1] / "worker" / "__main__.py"
PACKAGE = f"{__package__.rpartition('.')[0]}.worker"
#: Whether a process that runs already can open memory without a name (`Channel.address_for_others`).
CAN_STAND_BY = os.path.isdir("/proc/self/fd")


class Worker(NamedTuple):
    """A process that was started for training, and the file that its error stream goes to."""

    process: subprocess.Popen[bytes]
    errors: IO[bytes]

    def send(self, **message: Any) -> None:
        """Write a message; one that is gone takes none, which its reader finds out."""
        with contextlib.suppress(OSError, ValueError):
            self.process.stdin.write(json.dumps(message).encode() + b"\n")  # type: ignore[union-attr]
            self.process.stdin.flush()  # type: ignore[union-attr]

    def end(self) -> None:
        """Close its input, which is its order to go, and wait for it; insist, if it stays."""
        with contextlib.suppress(OSError):
            self.process.stdin.close()  # type: ignore[union-attr]
        for insist in (lambda: None, self.process.terminate, self.process.kill):
            insist()
            try:
                self.process.wait(timeout=0.7)
                return
            except subprocess.TimeoutExpired:
                pass
        self.process.wait()

    def close(self) -> None:
        """End it, if it has not ended, and close what belongs to it; nobody reads its answers any more."""
        self.end()
        self.process.stdout.close()  # type: ignore[union-attr]
        self.errors.close()


def launch(
    script: Path, interpreter: str | None = None, thread_count: int = 1, descriptors: Sequence[int] = ()
) -> Worker:
    """Start a process that waits for its configuration.

    Parameters
    ----------
    interpreter : str or None
        Python to run `script` by; None: the renderer's own.
    thread_count : int
    descriptors : sequence of int
        Open files that it inherits.

    Raises
    ------
    OSError
        If it could not be started.
    """
    environment = dict(os.environ)
    # Threads that wait for work must not burn the renderer's processors.
    environment.update(OMP_NUM_THREADS=str(thread_count), OMP_WAIT_POLICY="PASSIVE", KMP_BLOCKTIME="0")
    extra: dict[str, Any] = {"pass_fds": tuple(descriptors)} if descriptors else {}
    if os.name == "nt":
        extra["creationflags"] = getattr(subprocess, "CREATE_NO_WINDOW", 0)
    errors = tempfile.TemporaryFile()
    try:
        process = subprocess.Popen(
            [interpreter or sys.executable, str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=errors,
            env=environment,
            **extra,
        )
    except OSError:
        errors.close()
        raise
    return Worker(process, errors)


def introduction() -> dict[str, Any]:
    """What a worker needs to find the engine."""
    return {"package": PACKAGE, "path": [entry for entry in sys.path if entry], "parent": os.getpid()}


_lock = threading.Lock()
_standing: Worker | None = None


def stand_by(thread_count: int = 1) -> None:
    """Have a worker stand by, if none does and the system allows it; returns at once and never raises."""
    global _standing
    with _lock:
        if not CAN_STAND_BY or (_standing is not None and _standing.process.poll() is None):
            return
        if _standing is not None:
            _standing.close()
            _standing = None
        # Without one, training starts its own, and says why where that fails too.
        with contextlib.suppress(OSError):
            _standing = launch(SCRIPT, thread_count=thread_count)
            _standing.send(**introduction(), stands_by=True)


def take(script: Path, interpreter: str | None) -> Worker | None:
    """The worker that stands by, if it is alive and runs this; nobody else gets it."""
    global _standing
    with _lock:
        if script != SCRIPT or interpreter not in (None, sys.executable):
            return None
        worker, _standing = _standing, None
    if worker is not None and worker.process.poll() is not None:
        worker.close()
        return None
    return worker


def dismiss() -> None:
    """End the worker that stands by, without waiting for what it is doing: it has nothing to lose."""
    worker = take(SCRIPT, None)
    if worker is not None:
        worker.process.kill()
        worker.close()
