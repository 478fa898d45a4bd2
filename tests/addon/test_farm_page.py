# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands of docs/farm.md do what the page says: a scheduler, two workers and a frame, each a process."""

from __future__ import annotations

import os
import re
import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from tests.helpers.waiting import wait_until

ROOT = Path(__file__).resolve().parents[2]
PAGE = (ROOT / "docs" / "farm.md").read_text("utf-8")


def commands(beginning: str) -> list[str]:
    """Lines of the page's block that has a line with this beginning."""
    for block in re.findall(r"^```\n(.*?)^```", PAGE, re.MULTILINE | re.DOTALL):
        if any(line.startswith(beginning) for line in block.splitlines()):
            return block.splitlines()
    raise LookupError(f"docs/farm.md has no command {beginning}")


class Farm:
    """Runs the page's commands with an address and a file of the test's."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.environment = os.environ | {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1",
        }
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            self.port = free.getsockname()[1]
        self._started: list[subprocess.Popen[bytes]] = []

    def line(self, command: str) -> str:
        """A command of the page, for here."""
        return command.replace("HOST", "127.0.0.1").replace("8786", str(self.port)).replace("####", "##")

    def start(self, command: str) -> Path:
        """Start one that goes on; returns the file that its words go to."""
        path = self.folder / f"words_{len(self._started)}.txt"
        with path.open("wb") as words:
            self._started.append(
                subprocess.Popen(
                    self.line(command), shell=True, cwd=self.folder, env=self.environment, stdout=words, stderr=words,
                    start_new_session=True,
                )
            )
        return path

    def wait_for_scheduler(self, words: Path) -> None:
        """Until it listens."""


        def listens() -> bool:
            assert self._started[-1].poll() is None, words.read_text()
            with socket.socket() as one:
                return one.connect_ex(("127.0.0.1", self.port)) == 0

        wait_until(listens, 0.2)

    def run(self, command: str, **environment: str) -> subprocess.CompletedProcess[str]:
        """Run one to its end."""
        return subprocess.run(
            self.line(command), shell=True, cwd=self.folder, env=self.environment | environment, capture_output=True,
            text=True, timeout=300,
        )

    def close(self) -> None:
        """End what goes on."""
        for process in self._started:
            if process.poll() is None:
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


@pytest.fixture
def farm(cube_scene: Any, blender: Any, tmp_path: Path) -> Iterator[Farm]:
    """With scene.blend in its folder: the cube, guided by a mixture, seven samples a pixel."""
    pytest.importorskip("distributed")
    if os.name != "posix":
        pytest.skip("the page's commands are for a shell")
    cube_scene.render.engine = "NEURALGUIDE"
    cube_scene.render.resolution_x, cube_scene.render.resolution_y = 96, 64
    ours = cube_scene.neuralguide
    ours.guiding_method, ours.samples, ours.threads, ours.deterministic = "VMM", 7, 1, True
    blender.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    farm = Farm(tmp_path)
    yield farm
    farm.close()


def picture(folder: Path, name: str) -> np.ndarray:
    (path,) = folder.glob(f"{name}*.exr")
    with OpenEXR.File(str(path)) as file:
        (channel,) = file.channels().values()
        return np.array(channel.pixels)


@pytest.mark.slow
@pytest.mark.parametrize("protocol", ["tcp", "tls"])
def test_a_frame_of_two_workers_is_that_of_one_process(farm: Farm, protocol: str) -> None:
    if protocol == "tls":
        if shutil.which("openssl") is None:
            pytest.skip("there is no openssl")
        for command in commands("openssl req -x509"):
            made = farm.run(command)
            assert made.returncode == 0, made.stderr
        exports = commands("export DASK_DISTRIBUTED__COMM__REQUIRE_ENCRYPTION")
        farm.environment |= dict(line.removeprefix("export ").split("=") for line in exports)
    start, worker, render = commands(f"dask scheduler --host {'tls://' if protocol == 'tls' else 'HOST'}")
    farm.wait_for_scheduler(farm.start(start))
    words = [farm.start(worker), farm.start(worker)]
    done = farm.run(render)
    assert done.returncode == 0, done.stdout + done.stderr + words[0].read_text() + words[1].read_text()
    alone = farm.run(render.replace(f"--cluster {protocol}://HOST:8786 ", "").replace("render_", "alone_"))
    assert alone.returncode == 0, alone.stdout + alone.stderr
    assert np.array_equal(picture(farm.folder, "render_"), picture(farm.folder, "alone_"))
    if protocol == "tls":
        nobody = farm.run(render, DASK_DISTRIBUTED__COMM__TLS__CLIENT__CERT="", DASK_DISTRIBUTED__COMM__TLS__CA_FILE="")
        assert nobody.returncode == 2 and "TLS__CA_FILE names no file" in nobody.stderr
        plain = farm.run(render.replace("tls://", "tcp://"))
        assert plain.returncode == 2 and "write tls://" in plain.stderr


@pytest.mark.slow
def test_an_array_job_goes_on_where_it_was(farm: Farm) -> None:
    """Two tasks of the page's array; then all again, of which nothing is rendered. They begin with the field."""
    learn = commands("python -m addon -b scene.blend -E NEURALGUIDE --set save_field=on")[0]
    *_, task = commands("#SBATCH")
    done = farm.run(learn)
    assert done.returncode == 0 and (farm.folder / "shot.ngfield").is_file(), done.stdout + done.stderr
    times = {}
    for number in ("1", "2", "1"):
        done = farm.run(task, SLURM_ARRAY_TASK_ID=number, SLURM_CPUS_PER_TASK="1")
        assert done.returncode == 0, done.stdout + done.stderr
        (path,) = farm.folder.glob(f"render_0{number}*")
        assert ("is left as it is" in done.stdout) == (number in times)
        assert times.setdefault(number, path.stat().st_mtime_ns) == path.stat().st_mtime_ns
        assert number in times or "started from" in done.stdout + done.stderr
