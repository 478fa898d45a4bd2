# SPDX-License-Identifier: GPL-3.0-or-later
"""What Cycles gave, recorded: means of its pictures of the built-in scenes, with all that they depend on.

Cycles does not change where our sources do, so that rendering it again for each test says nothing new. A record counts
for the Blender that it was made by, and as long as the scene's builders and the samples are the same; else Cycles is
rendered. `python -m tests.helpers.parity` makes records anew.
"""

from __future__ import annotations

import ast
import functools
import hashlib
import io
import json
import tokenize
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.images import Float32Array
from benchmarks.picture_means import Means, PictureMeans, picture_means
from benchmarks.scenes import SCENES
from tests.helpers.parity.scenes import PIXELS, Comparison

FOLDER = Path(__file__).parent / "cycles"
ROWS, COLUMNS = 4, 6
#: How many pictures of Cycles are recorded.
SEEDS = 4
_ARRAYS = ("channels", "channel_variances", "cells", "cell_variances", "cell_spreads")
_ROOT = Path(__file__).resolve().parents[3]


def grid_means(images: list[Float32Array]) -> PictureMeans:
    """Means of the pictures of some seeds, over the cells that are recorded."""
    return picture_means(images, ROWS, COLUMNS)


def blender_version() -> str:
    """Version of the Blender that runs, such as 5.0.1."""
    import bpy

    return ".".join(map(str, bpy.app.version))


def _module_file(module: str) -> Path | None:
    path = _ROOT.joinpath(*module.split("."))
    for file in (path.with_suffix(".py"), path / "__init__.py"):
        if file.exists():
            return file
    return None


@functools.cache
def _builder_sources(modules: frozenset[str]) -> frozenset[Path]:
    """Modules of a scene and those of `benchmarks.scenes` that they import, directly or not."""
    found: set[Path] = set()
    waiting = [*modules]
    while waiting:
        file = _module_file(waiting.pop())
        # The package itself imports every scene: whoever imports something from it means that.
        if file is None or file in found or file == _ROOT / "benchmarks/scenes/__init__.py":
            continue
        found.add(file)
        for node in ast.walk(ast.parse(file.read_text("utf-8"))):
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith("benchmarks.scenes"):
                waiting += [str(node.module), *(f"{node.module}.{alias.name}" for alias in node.names)]
    return frozenset(found)


@functools.cache
def code_of(text: str) -> str:
    """A module's lines without docstrings, comments and blank ones: the same by every version of Python."""
    lines = text.splitlines()
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type == tokenize.COMMENT:
            row, column = token.start
            lines[row - 1] = lines[row - 1][:column]
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant) and isinstance(node.value.value, str):
            last = node.end_lineno or node.lineno
            lines[node.lineno - 1 : last] = [""] * (last - node.lineno + 1)
    return "\n".join(line.rstrip() for line in lines if line.strip())


def scene_hash(name: str) -> str:
    """Identity of a built-in scene: the code that registers and builds it, and of the modules that this imports."""
    digest = hashlib.sha256()
    for file in sorted(_builder_sources(frozenset({SCENES[name].module, SCENES[name].build.__module__}))):
        digest.update(code_of(file.read_text("utf-8")).encode())
    return digest.hexdigest()[:16]


def conditions(comparison: Comparison, scene: str) -> dict[str, Any]:
    """What a record depends on, beside Blender's version; how many seeds it has, it says itself."""
    return {"scene": scene_hash(scene), "samples": comparison.samples_of(scene), "pixels": PIXELS}


def file_of(comparison: Comparison) -> Path:
    """The records of a comparison."""
    return FOLDER / f"{comparison.name}.json"


def read(comparison: Comparison) -> dict[str, Any]:
    """All records of a comparison, by scene, and Blender's version as `blender`."""
    file = file_of(comparison)
    found: dict[str, Any] = json.loads(file.read_text("utf-8")) if file.exists() else {"blender": "", "scenes": {}}
    return found


@functools.cache
def _read_once(comparison: Comparison) -> dict[str, Any]:
    return read(comparison)


def is_current(comparison: Comparison, scene: str, record: dict[str, Any] | None) -> bool:
    """Whether a record is of the scene and the samples of today."""
    return record is not None and record["of"] == conditions(comparison, scene)


def recorded(comparison: Comparison, scene: str) -> PictureMeans | None:
    """What Cycles gave in the Blender that runs, None where no record says so."""
    records = _read_once(comparison)
    record = records["scenes"].get(scene)
    if records["blender"] != blender_version() or not is_current(comparison, scene, record):
        return None
    return PictureMeans(record["seeds"], *(np.asarray(record[name], np.float64) for name in _ARRAYS))


def as_record(comparison: Comparison, scene: str, means: PictureMeans) -> dict[str, Any]:
    """A record to write: means with as many digits as float32 has, and variances, which are estimates, with three."""
    return {
        "of": conditions(comparison, scene),
        "seeds": means.seeds,
        **{name: _rounded(getattr(means, name), 7 if name in ("channels", "cells") else 3) for name in _ARRAYS},
    }


def _rounded(values: Means, digits: int) -> Any:
    return json.loads(json.dumps(values.tolist()), parse_float=lambda text: float(f"{float(text):.{digits}g}"))


def write(comparison: Comparison, version: str, scenes: dict[str, Any]) -> None:
    """Write the records of a comparison, a line a scene."""
    lines = [f"{json.dumps(name)}: {json.dumps(scenes[name])}" for name in sorted(scenes)]
    text = f'{{"blender": {json.dumps(version)}, "scenes": {{\n' + ",\n".join(lines) + "\n}}\n"
    FOLDER.mkdir(exist_ok=True)
    file_of(comparison).write_text(text, "utf-8")
