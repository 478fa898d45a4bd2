# SPDX-License-Identifier: GPL-3.0-or-later
"""The commands that the pages show: each is read by its own program, and those that render are run as they stand.

Programs stop as soon as they have read their arguments, so that a command that takes hours is tested in a moment: what
it does then is tested where it is.
"""

from __future__ import annotations

import argparse
import os
import re
import runpy
import shlex
import subprocess
import sys
from collections.abc import Iterator
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[1]
_BLOCK = re.compile(r"^ *```.*?^ *```[^\n]*$", re.MULTILINE | re.DOTALL)
_SPAN = re.compile(r"`([^`\n]+)`")
_COMMAND = re.compile(r"(?:\.venv/bin/)?python[\d.]* (?:-m|tools/)|make [a-z]")
#: What stands for a number; other words in capitals are names of files.
_NUMBERS = {"T": "0.1"}
_RENDERS = re.compile(r"python -m addon .*-f ")


def documented_commands() -> list[str]:
    """All of them, once each."""
    listed = subprocess.run(["git", "ls-files", "*.md"], cwd=ROOT, capture_output=True, text=True, check=True)
    found: dict[str, None] = {}
    for name in listed.stdout.split():
        text = (ROOT / name).read_text("utf-8")
        lines = [line for block in _BLOCK.findall(text) for line in block.replace("\\\n", " ").splitlines()]
        for line in (*lines, *_SPAN.findall(_BLOCK.sub("", text))):
            command = line.partition(" #")[0].strip()
            if _COMMAND.match(command):
                found[command] = None
    return list(found)


COMMANDS = documented_commands()
#: Those of programs of ours, not of packages.
OF_PYTHON = [command for command in COMMANDS if not command.startswith(("make ", "python -m pip "))]


class Read(Exception):
    """The arguments have been read."""


@pytest.fixture
def stops_when_read(monkeypatch: pytest.MonkeyPatch) -> None:
    """Programs end once their arguments are read."""
    parse = argparse.ArgumentParser.parse_args

    def parse_and_stop(self: argparse.ArgumentParser, *arguments: Any) -> Any:
        parse(self, *arguments)
        raise Read

    monkeypatch.setattr(argparse.ArgumentParser, "parse_args", parse_and_stop)


def test_there_are_commands_of_all_kinds() -> None:
    assert len(COMMANDS) > 40
    assert sum(command.startswith("make ") for command in COMMANDS) > 5
    assert sum("-m addon" in command for command in COMMANDS) > 5


@pytest.mark.parametrize("command", [command for command in COMMANDS if command.startswith("make ")])
def test_make_knows_what_to_do(command: str) -> None:
    done = subprocess.run(["make", "-n", *command.split()[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


@pytest.mark.filterwarnings("ignore:.*found in sys.modules:RuntimeWarning")
@pytest.mark.usefixtures("stops_when_read")
@pytest.mark.parametrize("command", OF_PYTHON)
def test_programs_understand_their_commands(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    words = [_NUMBERS.get(word, word) for word in shlex.split(command)]
    is_module = words[1] == "-m"
    name, arguments = (words[2], words[3:]) if is_module else (words[1], words[2:])
    if name == "addon":
        from addon.cli_arguments import parse_arguments

        # A job's number and threads come from the farm's shell. Where the program is only named, it has its say.
        assert parse_arguments(["1" if word.startswith("$") else word for word in arguments or ["--help"]])
        return
    path = ROOT / name if not is_module else ROOT.joinpath(*name.split("."))
    source = next(file for file in (path, path.with_suffix(".py"), path / "__main__.py") if file.is_file())
    if "argparse" not in source.read_text("utf-8"):
        assert not arguments, f"{name} takes no arguments"
        return
    if len(arguments) <= (name == "benchmarks"):
        # Named, without what it needs: that it can say what that is.
        arguments.append("--help")
    monkeypatch.setattr(sys, "argv", [name, *arguments])
    # As Python does for a file that it runs.
    monkeypatch.syspath_prepend(ROOT if is_module else source.parent)
    with pytest.raises((Read, SystemExit)) as ended:
        if is_module:
            runpy.run_module(name, run_name="__main__")
        else:
            runpy.run_path(str(source), run_name="__main__")
    assert ended.type is Read or ended.value.code == 0, f"{name} does not understand {arguments}"


def _before(words: list[str]) -> Iterator[str]:
    """What must be rendered before a command: the field or the films that it starts from."""
    values = {word: [value for other, value in pairwise(words) if other == word] for word in words}
    if "--field" in words and "save_field=on" not in words:
        yield f"--set guiding_method=VMM --set samples=16 --set save_field=on --field {values['--field'][0]}"
    if "--add-samples" in words:
        yield f"-E NEURALGUIDE --keep-film -o {values['-o'][0]}"
    for seed, picture in enumerate(values.get("--merge", ())):
        yield f"-E NEURALGUIDE --set seed={seed} --keep-film -o {picture.removesuffix('.exr')}"


@pytest.mark.slow
@pytest.mark.parametrize(
    "command",
    # `test_farm_page.py` has a cluster.
    [c for c in COMMANDS if _RENDERS.search(c) and "--cluster" not in c],
)
def test_commands_that_render_render(command: str, cube_scene: Any, tmp_path: Path) -> None:
    """As they stand, in the folder of a file of the name that they have."""
    import bpy

    cube_scene.render.filepath = "//image_####"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "scene.blend"))
    words = shlex.split(command.replace("$SLURM_CPUS_PER_TASK", "1").replace("$SLURM_ARRAY_TASK_ID", "1"))
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    for making in _before(words):
        first = [sys.executable, "-m", "addon", "scene.blend", *making.split(), "-f", "1"]
        subprocess.run(first, cwd=tmp_path, env=environment, check=True)
    done = subprocess.run(
        [sys.executable, *words[1:]], cwd=tmp_path, env=environment, capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    assert list(tmp_path.glob("*0001*")), f"no picture: {[file.name for file in tmp_path.iterdir()]}"
