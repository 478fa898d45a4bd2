# SPDX-License-Identifier: GPL-3.0-or-later
"""A process that the renderer starts: a line of configuration and messages go in, its end comes when they end.

It is a plain subprocess, so that it may run under another Python than the renderer's. When the renderer goes, however
it goes, the process's input ends, and with it the process (`parent.leave_with_parent`).
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import IO, Any

from engine.processes.memory import SharedMemory

#: What the process runs: finds the engine and hands over to a service.
ENTRY = Path(__file__).resolve().with_name("__main__.py")
_ENGINE = __package__.rpartition(".")[0]


class Child:
    """One process.

    Parameters
    ----------
    interpreter : str
    service : str
        Module of the engine whose `serve(config, stream, answers)` the process calls ('guiding.neural.worker.process').
    config : dict
        For the service; of what JSON has.
    memories : collection of SharedMemory
        Handed to the process; their addresses are the caller's to put into `config`.
    environment : mapping
        Variables that differ from this process's.
    has_answers : bool
        Whether the process's standard output is read here; else it goes where its errors go.
    is_background : bool
        Whether the process steps back where others want the processor.
    has_same_path : bool
        Whether the process looks for modules just where this one does; else there too, after its own places.
    script : Path
        Anything that speaks the same protocol.

    Attributes
    ----------
    process : Popen

    Raises
    ------
    OSError
        If the process cannot be started.
    """

    def __init__(
        self, interpreter: str, service: str, config: dict[str, Any], *, memories: Collection[SharedMemory] = (),
        environment: Mapping[str, str] | None = None, has_answers: bool = True, is_background: bool = False,
        has_same_path: bool = False, script: Path = ENTRY,
    ) -> None:
        extra: dict[str, Any] = {}
        if os.name == "posix":
            extra["pass_fds"] = tuple(memory.descriptor for memory in memories)
        if os.name == "nt":
            extra["creationflags"] = getattr(subprocess, "CREATE_NO_WINDOW", 0)
            if is_background:
                extra["creationflags"] |= getattr(subprocess, "BELOW_NORMAL_PRIORITY_CLASS", 0)
        self._errors: IO[bytes] = tempfile.TemporaryFile()
        try:
            self.process = subprocess.Popen(
                [interpreter, str(script)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE if has_answers else self._errors,
                stderr=self._errors,
                env={**os.environ, **(environment or {})},
                **extra,
            )
        except OSError:
            self._errors.close()
            raise
        self.send(
            engine=_ENGINE, service=service, path=[entry for entry in sys.path if entry], parent=os.getpid(),
            is_background=is_background, has_same_path=has_same_path, **config,
        )

    def send(self, **message: Any) -> None:
        """Send a message; waits where the process has not read the earlier ones, and a pipe is full of them."""
        stream = self.process.stdin
        assert stream is not None
        # A process that is gone is found by who waits for it.
        with contextlib.suppress(OSError, ValueError):
            stream.write(json.dumps(message).encode() + b"\n")
            stream.flush()

    def reason(self, code: int) -> str:
        """Why the process ended with `code`, for users: 'was ended by ...' or 'ended with ...'."""
        if code < 0:
            with contextlib.suppress(ValueError):
                name = signal.Signals(-code).name
                hint = ", perhaps for want of memory" if name == "SIGKILL" else ""
                return f"was ended by {name}{hint}"
        last = ""
        with contextlib.suppress(ValueError, OSError):
            size = self._errors.seek(0, os.SEEK_END)
            self._errors.seek(max(0, size - 4096))
            lines = self._errors.read().decode(errors="replace").strip().splitlines()
            last = f": {lines[-1]}" if lines else ""
        return f"ended with code {code}{last}"

    def close(self, *, is_patient: bool = True) -> None:
        """Close the process's input and wait for its end; insist, if it stays.

        Parameters
        ----------
        is_patient : bool
            False: it is hung, and is not asked first.
        """
        process = self.process
        with contextlib.suppress(OSError):
            process.stdin.close()  # type: ignore[union-attr]
        for insist in ((lambda: None, process.terminate) if is_patient else ()) + (process.kill,):
            insist()
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(timeout=0.7)
                break
        else:
            process.wait()

    def release(self) -> None:
        """Free what is left of the process; after `close`, when nobody reads its answers any more."""
        if self.process.stdout is not None:
            self.process.stdout.close()
        self._errors.close()
