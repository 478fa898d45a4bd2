# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that are killed at any moment, many a minute: a process that has built its scene forks each of them.

As a module, `python -m tests.helpers.killed_renders FOLDER SETTINGS` is that process. It renders the scene whole, and
then once for each line that it reads: how long the render may live [s]. It answers each with a line of what came of it.
"""

from __future__ import annotations

import json
import math
import mmap
import os
import select
import signal
import struct
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from engine.render import checkpointing
from engine.render.checkpointing import Checkpointing, CheckpointPlan
from engine.render.session import Session
from engine.scene.digest import SceneDigest
from engine.settings import RenderSettings
from tests.helpers.small_scenes import pit_scene, sun

ROOT = Path(__file__).resolve().parents[2]
PASSES = {"Combined", "Depth", "Variance", "Sample Count"}
#: Of the checkpoint, of the whole picture, and of that of a render which was killed before.
CHECKPOINT, WHOLE, RESUMED = "x.ngcheckpoint", "whole.npz", "resumed.npz"
FINISHED = -1


@dataclass(frozen=True)
class Fate:
    """What came of a render.

    was_killed : bool
    announced : int, paths that the checkpoint had which it wrote last, 0: it wrote none; FINISHED: its picture is there
    orphans : int, processes that it has left
    """

    was_killed: bool
    announced: int
    orphans: int


class KilledRenders:
    """The process that forks them, for tests.

    Parameters
    ----------
    folder : Path
        Where it leaves its files.
    **settings
        Of `RenderSettings`.
    """

    def __init__(self, folder: Path, **settings: Any) -> None:
        line = [sys.executable, "-m", "tests.helpers.killed_renders", str(folder), json.dumps(settings)]
        self._process = subprocess.Popen(line, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        self.folder = folder
        self._answer()

    def render(self, seconds: float) -> Fate:
        """Go on with the frame, and kill that so long after it has begun."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{seconds}\n")
        self._process.stdin.flush()
        return Fate(**self._answer())

    def _answer(self) -> Any:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, f"the process ended: {self._process.wait()}"
        return json.loads(line)

    def passes(self, name: str) -> dict[str, Any]:
        """A picture that is there."""
        with np.load(self.folder / name) as found:
            return dict(found)

    def close(self) -> None:
        """Have the process end."""
        self._process.communicate()
        assert self._process.returncode == 0


class _Server:
    def __init__(self, folder: Path, settings: dict[str, Any]) -> None:
        description = pit_scene(size=(70, 40))
        description.lights = [sun(2.0)]
        self._folder = folder
        self._session = Session(RenderSettings(threads=1, **settings))
        self._session.load(description)
        self._plan = CheckpointPlan(
            folder / CHECKPOINT, SceneDigest(description), self._session.settings.seed, interval=0.002, resumes=True
        )
        self._announced = mmap.mmap(-1, 8)
        self._render(WHOLE)

    def _render(self, name: str) -> None:
        result = self._session.render(passes=PASSES)
        np.savez(self._folder / name, **result.passes)  # type: ignore[arg-type]

    def fate(self, seconds: float) -> dict[str, Any]:
        """Of a render that may live so long."""
        self._announced[:] = struct.pack("q", 0)
        begun, begins = os.pipe()
        child = os.fork()
        if child == 0:
            try:
                self._live(begins)
            finally:
                # Whatever failed, the server's code is not to go on here.
                os._exit(1)
        os.close(begins)
        os.read(begun, 1)
        # It is at its end where the pipe is closed.
        if not select.select([begun], [], [], None if math.isinf(seconds) else seconds)[0]:
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        os.close(begun)
        assert status in (0, -signal.SIGKILL), status
        (announced,) = struct.unpack("q", self._announced)
        return {"was_killed": status != 0, "announced": announced, "orphans": _processes_of(child)}

    def _live(self, begins: int) -> None:
        """Go on with the frame to its end, with one checkpoint after the other."""
        os.setsid()
        real = checkpointing.save_checkpoint

        def save(path: Path, checkpoint: Any, *others: Any) -> None:
            real(path, checkpoint, *others)
            self._announced[:] = struct.pack("q", checkpoint.state.path_count)

        checkpointing.save_checkpoint = save
        kept = Checkpointing(self._plan, lambda notice: print(notice, file=sys.stderr))
        self._session.checkpointing = kept
        os.write(begins, b".")
        self._render(RESUMED)
        self._announced[:] = struct.pack("q", FINISHED)
        kept.discard()
        os._exit(0)


def _processes_of(session: int) -> int:
    """How many processes there are of one that has made itself a session."""
    count = 0
    for entry in Path("/proc").glob("[0-9]*/stat"):
        try:
            # Its fields come after the name, which may hold anything: state, parent, group, session.
            count += int(entry.read_text(encoding="utf-8").rpartition(")")[2].split()[3]) == session
        except OSError:  # it has ended
            continue
    return count


def main() -> None:
    """Serve."""
    server = _Server(Path(sys.argv[1]), json.loads(sys.argv[2]))
    print("{}", flush=True)
    for line in sys.stdin:
        print(json.dumps(server.fate(float(line))), flush=True)


if __name__ == "__main__":
    main()
