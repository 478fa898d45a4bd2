# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that are killed at any moment, many a minute: a process that has built its scene forks each of them.

As a module, `python -m tests.helpers.killed_renders FOLDER SETTINGS` is that process. It renders the scene whole, and
then once for each line that it reads: how many checkpoints the render may live. It answers each with a line of what
came of it. Half a checkpoint is half of the time that the last one took: so a busy machine kills no sooner.
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
import time
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
_ANNOUNCED = struct.Struct("qq")
#: Between two looks at that, and about what the first checkpoint takes [s].
_NAP, _FIRST = 0.001, 0.05


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

    def render(self, life: float) -> Fate:
        """Go on with the frame, and kill that after so many checkpoints."""
        assert self._process.stdin is not None
        self._process.stdin.write(f"{life}\n")
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
        #: Of the render: paths that are kept, and how many checkpoints it has written.
        self._announced = mmap.mmap(-1, _ANNOUNCED.size)
        self._render(WHOLE)

    def _render(self, name: str) -> None:
        result = self._session.render(passes=PASSES)
        np.savez(self._folder / name, **result.passes)  # type: ignore[arg-type]

    def fate(self, life: float) -> dict[str, Any]:
        """Of a render that may write so many checkpoints."""
        self._announced[:] = _ANNOUNCED.pack(0, 0)
        begun, begins = os.pipe()
        child = os.fork()
        if child == 0:
            code = 1
            try:
                self._live(begins)
                code = 0
            finally:
                # Whatever failed, the server's code is not to go on here.
                os._exit(code)
        os.close(begins)
        os.read(begun, 1)
        if not self._outlives(begun, life):
            os.kill(child, signal.SIGKILL)
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        os.close(begun)
        assert status in (0, -signal.SIGKILL), status
        announced, _ = _ANNOUNCED.unpack(self._announced)
        return {"was_killed": status != 0, "announced": announced, "orphans": _processes_of(child)}

    def _outlives(self, begun: int, life: float) -> bool:
        """Wait until a render has had its life, or is at its end, where its pipe is closed."""
        before = last = time.monotonic()
        written = 0
        while written < math.floor(life) if life < math.inf else True:
            if select.select([begun], [], [], _NAP)[0]:
                return True
            _, now_written = _ANNOUNCED.unpack(self._announced)
            if now_written > written:
                before, last, written = last, time.monotonic(), now_written
        rest = (life - math.floor(life)) * (last - before if written else _FIRST)
        return bool(select.select([begun], [], [], rest)[0])

    def _live(self, begins: int) -> None:
        """Go on with the frame to its end, with one checkpoint after the other."""
        os.setsid()
        real = checkpointing.save_checkpoint

        def save(path: Path, checkpoint: Any, *others: Any) -> None:
            real(path, checkpoint, *others)
            _, written = _ANNOUNCED.unpack(self._announced)
            self._announced[:] = _ANNOUNCED.pack(checkpoint.state.path_count, written + 1)

        checkpointing.save_checkpoint = save
        kept = Checkpointing(self._plan, lambda notice: print(notice, file=sys.stderr))
        self._session.checkpointing = kept
        os.write(begins, b".")
        self._render(RESUMED)
        self._announced[:] = _ANNOUNCED.pack(FINISHED, 0)
        kept.discard()


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
