# SPDX-License-Identifier: GPL-3.0-or-later
"""What the conversion of a kind of lamp is made of: its record, what it reads and what it completes.

All lamps of a kind are converted at once: a scene may have a hundred thousand.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np

from engine.kernels.lights.lamp import Lamp
from engine.scene.description import Light
from engine.state import lights as la


def norm(vectors: np.ndarray) -> np.ndarray:
    """Lengths of vectors, (..., 3) -> (...)."""
    return np.sqrt((vectors * vectors).sum(axis=-1))


def unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors of length 1, (..., 3); those without a length stay."""
    length = norm(vectors)[..., None]
    return np.where(length > 0.0, vectors / np.where(length > 0.0, length, 1.0), vectors)


@dataclass
class LampColumns:
    """Fields of `Light`, an array each, of N lamps; colour times energy as `strength`.

    Attributes
    ----------
    own : dict of str to array (N,)
        Fields that only some kinds have, by name: all that any kind's `measures` and `choices` list.
    matrix : float64 (N, 4, 4)
        Object to world.
    strength, estimate : float64 (N, 3)
        Colour times energy, times the program's emission where that is constant; factor on it that the program is
        expected to give, 1 without a program.
    temperature : float64 (N,)
        [K] of the black body whose colour it is, 0 = none.
    program : int64 (N,)
        That has to run, -1 = none.
    """

    index: np.ndarray
    kind: np.ndarray
    own: dict[str, np.ndarray]
    matrix: np.ndarray
    strength: np.ndarray
    estimate: np.ndarray
    temperature: np.ndarray
    program: np.ndarray
    is_normalized: np.ndarray
    flags: np.ndarray
    visibility: np.ndarray
    max_bounces: np.ndarray
    light_group: np.ndarray

    def pick(self, chosen: np.ndarray) -> LampColumns:
        """Those lamps alone."""
        own = {name: column[chosen] for name, column in self.own.items()}
        common = {of.name: getattr(self, of.name)[chosen] for of in fields(self) if of.name != "own"}
        return LampColumns(own=own, **common)

    @property
    def mean(self) -> np.ndarray:
        """Magnitude of the emission, mean of channels, (N,)."""
        return np.abs(self.strength * self.estimate).mean(axis=1)

    @property
    def axes(self) -> np.ndarray:
        """Its own axes in the world, as columns, (N, 3, 3)."""
        return self.matrix[:, :3, :3]

    @property
    def inverse_axes(self) -> np.ndarray:
        """From the world to its own axes, (N, 3, 3); those of lamps without extent stay the world's."""
        is_invertible = np.abs(np.linalg.det(self.axes)) >= 1e-30
        return np.linalg.inv(np.where(is_invertible[:, None, None], self.axes, np.eye(3)))

    @property
    def direction(self) -> np.ndarray:
        """Direction of the lamp's own -z, unit, (N, 3)."""
        return unit(-self.matrix[:, :3, 2])


@dataclass
class LampDraft:
    """Rows that the function of their kind completes.

    Attributes
    ----------
    scale : float64 (N,)
        Radiance over strength.
    is_usable : bool (N,)
        False where a lamp cannot light anything.
    flags : int64 (N,)
        LAMP_FLAG_* bits.
    values, bounds, distant : float64
        As in `Lamps`.
    """

    scale: np.ndarray
    is_usable: np.ndarray
    flags: np.ndarray
    values: np.ndarray
    bounds: np.ndarray
    distant: np.ndarray

    def make_delta(self, chosen: np.ndarray) -> None:
        """No ray finds these by chance."""
        self.flags[chosen] = (self.flags[chosen] | la.LAMP_FLAG_DELTA) & ~la.LAMP_FLAG_MIS


@dataclass(frozen=True)
class LampKind:
    """How lamps of a kind become rows of `LightArrays`.

    Attributes
    ----------
    lamp : Lamp
        What kernels know of it.
    convert : callable (LampColumns, LampDraft)
        Completes drafts: radiance, the kind's own columns and flags, and what the light tree goes by. That is a box
        around the lamp, its strongest radiant intensity, the cone that its normals lie in, how far from them it emits,
        and its size (`engine.builder.light_tree`, BOUNDS_*); of lamps that are infinitely far away
        `LampDraft.distant`.
    measures : tuple of str
        Fields of `Light` that say how large a lamp is: one where any is no number is left out.
    choices : tuple of str
        Other fields of `Light` that only some kinds have.
    corners : callable (Light) -> float64 (4, 3), optional
        Of kinds that are flat, and so may lie in a surface: corners in turn of what a lamp covers, world [m]; of round
        ones, of the square around them.
    example : mapping
        Fields of a `Light` of the kind that is wide as seen from a metre below: by it kernels are compiled ahead, and
        tested.
    """

    lamp: Lamp
    convert: Callable[[LampColumns, LampDraft], None]
    measures: tuple[str, ...]
    choices: tuple[str, ...] = ()
    corners: Callable[[Light], np.ndarray] | None = None
    example: Mapping[str, Any] = field(default_factory=dict)
