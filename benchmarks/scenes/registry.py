# SPDX-License-Identifier: GPL-3.0-or-later
"""The table of scenes this project builds itself."""

from __future__ import annotations

import hashlib
import inspect
import re
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

Builder = Callable[[], None]


@dataclass(frozen=True)
class BuiltinScene:
    """A scene and what comparing it takes.

    Attributes
    ----------
    build : callable
        Fills the current, empty `bpy` scene, camera and resolution included.
    samples : int
        Samples per pixel with which two or more seeds compare well.
    note : str
        A documented difference from Cycles, shown beside the figures; '' if none.
    allowance : float
        How large that difference may be in a cell, relative.
    """

    name: str
    build: Builder
    samples: int = 64
    note: str = ""
    allowance: float = 0.0
    module: str = ""

    @property
    def group(self) -> str:
        """Module it comes from: closures, lights, ..."""
        return self.module.rpartition(".")[2]

    @property
    def description(self) -> str:
        """First sentence of the builder's docstring."""
        return re.split(r"\.(?:\s|$)", inspect.getdoc(self.build) or self.name)[0]


SCENES: dict[str, BuiltinScene] = {}


def scene(
    name: str, samples: int = 64, note: str = "", allowance: float = 0.0, module: str = ""
) -> Callable[[Builder], Builder]:
    """Register a builder under `name`; its module names the group it is shown in."""

    def register(builder: Builder) -> Builder:
        if name in SCENES:
            raise ValueError(f"two scenes are called {name!r}")
        SCENES[name] = BuiltinScene(name, builder, samples, note, allowance, module or builder.__module__)
        return builder

    return register


def build(name: str) -> None:
    """Replace the open file by the scene `name`.

    Raises
    ------
    ValueError
        Naming the scenes there are.
    """
    if name not in SCENES:
        raise ValueError(f"no scene builtin:{name}; there are: {', '.join(sorted(SCENES))}")
    import bpy

    bpy.ops.wm.read_homefile(use_empty=True)
    SCENES[name].build()
    bpy.context.view_layer.update()


def source_hash() -> str:
    """Hash of every builder's source: the identity of built-in scenes."""
    digest = hashlib.sha256()
    here = Path(__file__).parent
    for file in sorted(here.rglob("*.py")):
        digest.update(file.read_bytes())
    return digest.hexdigest()
