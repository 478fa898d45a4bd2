# SPDX-License-Identifier: GPL-3.0-or-later
"""What all programs of a scene share: slots of attributes, tables, images, notices."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array
from engine.scene.description import Image, Notice
from engine.shaders.compiled_program import Asked, CompiledProgram
from engine.shaders.image_pool import srgb_table
from engine.spectral.observer import XYZ_TO_REC709

_NO_PIXELS = np.zeros((0, 0, 4), np.uint8)


class ScenePools:
    """Pools shared by all programs."""

    def __init__(
        self, images: Sequence[Image], to_xyz: Float32Array | None, grid_names: frozenset[str] = frozenset()
    ) -> None:
        self._images = images
        self._grid_names = grid_names
        self.to_xyz = to_xyz
        #: Luminance of the working space's primaries, and the matrix to it from Rec.709; None where it is Rec.709.
        self.luminance: tuple[float, ...] | None = None
        self.from_rec709: npt.NDArray[np.float64] | None = None
        if to_xyz is not None:
            self.luminance = tuple(float(weight) for weight in to_xyz[1])
            self.from_rec709 = np.linalg.inv(XYZ_TO_REC709.astype(np.float64) @ to_xyz.astype(np.float64))
        self.attribute_names: list[str] = []
        self.notices: list[Notice] = []
        self._tables: list[Float32Array] = [srgb_table()]
        self._table_size = len(self._tables[0])
        self._known_tables: dict[bytes, int] = {}
        self._joined: Float32Array | None = None
        #: What the program in work has asked for, and what it reports.
        self._asked: list[Asked] = []
        self._found: list[Notice] = []

    def begin(self) -> tuple[list[Asked], list[Notice]]:
        """Begin a program: lists of what it will have asked for, and reported."""
        self._asked, self._found = [], []
        return self._asked, self._found

    def answers(self, program: CompiledProgram) -> bool:
        """Give a finished program what it asked for once more; whether all answers are the same."""
        self.begin()
        is_same = all(getattr(self, method)(argument) == answer for method, argument, answer in program.asked)
        if is_same:
            for notice in program.notices:
                self._report(notice)
        return is_same

    def _report(self, notice: Notice) -> None:
        if notice not in self.notices:
            self.notices.append(notice)

    def notice(self, subject: str, problem: str, fallback: str) -> None:
        """Report once."""
        self._found.append(Notice(subject, problem, fallback))
        self._report(self._found[-1])

    def attribute_slot(self, name: str) -> int:
        """Slot of a mesh attribute."""
        if name not in self.attribute_names:
            self.attribute_names.append(name)
        slot = self.attribute_names.index(name)
        self._asked.append(("attribute_slot", name, slot))
        return slot

    def has_grid(self, name: str) -> bool:
        """Whether any volume of the scene has a grid of this name."""
        answer = name in self._grid_names
        self._asked.append(("has_grid", name, answer))
        return answer

    def add_table(self, values: npt.ArrayLike) -> int:
        """Index of the table's first float in the pool."""
        table = np.ascontiguousarray(values, np.float32).ravel()
        key = table.tobytes()
        if key not in self._known_tables:
            self._known_tables[key] = self._table_size
            self._tables.append(table)
            self._table_size += len(table)
            self._joined = None
        self._asked.append(("add_table", table, self._known_tables[key]))
        return self._known_tables[key]

    def image(self, index: int) -> Image | None:
        """An image without its pixels, None if it is missing."""
        image = None
        if 0 <= index < len(self._images):
            image = replace(self._images[index], key=None, pixels=_NO_PIXELS)
        self._asked.append(("image", index, image))
        return image

    def tables(self) -> Float32Array:
        """The pool so far."""
        if self._joined is None:
            self._joined = np.concatenate(self._tables)
        return self._joined
