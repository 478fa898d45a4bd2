# SPDX-License-Identifier: GPL-3.0-or-later
"""What was learned as arrays by name: to keep it beyond a render, to write it to a file and to read it back."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

#: No number of a state is larger: kernels' sums of them, in float32, stay finite.
MOST = 1e30

#: Arrays by name. Dots in a name separate what the array belongs to from what it is.
State = dict[str, np.ndarray]


class StateError(ValueError):
    """Arrays that are no state; the message says which and why."""


def take(state: State, name: str, dtype: npt.DTypeLike, shape: tuple[int | None, ...]) -> np.ndarray:
    """A copy of an array.

    Parameters
    ----------
    dtype : what it must have
    shape : tuple of int or None
        What it must have; None: any size.

    Raises
    ------
    StateError
        If it is missing, has another type or shape, or holds a number that is not finite, or beyond `MOST`.
    """
    array = state.get(name)
    if array is None:
        raise StateError(f"{name} is missing")
    if array.dtype != np.dtype(dtype):
        raise StateError(f"{name} has numbers of the type {array.dtype}, not {np.dtype(dtype)}")
    fits = len(shape) == array.ndim and all(
        wanted is None or wanted == size for wanted, size in zip(shape, array.shape, strict=True)
    )
    if not fits:
        raise StateError(f"{name} has the shape {array.shape}, not {shape}")
    _check_numbers(name, array)
    return np.array(array, order="C")


def check_numbers(state: State) -> None:
    """Raise where a number would keep the state from being taken again.

    Raises
    ------
    StateError
        If an array holds a number that is not finite, or beyond `MOST`.
    """
    for name, array in state.items():
        _check_numbers(name, array)


def _check_numbers(name: str, array: np.ndarray) -> None:
    if array.dtype.kind != "f" or not array.size:
        return
    if not np.isfinite(array).all():
        raise StateError(f"{name} holds numbers that are not finite")
    if np.abs(array).max() > MOST:
        raise StateError(f"{name} holds numbers that are too large")


def require(is_so: bool | np.bool_, problem: str) -> None:
    """Raise where something is not so.

    Raises
    ------
    StateError
    """
    if not is_so:
        raise StateError(problem)


def prefixed(prefix: str, state: State) -> State:
    """A state as a part of a larger one."""
    return {f"{prefix}.{name}": array for name, array in state.items()}


def part(state: State, prefix: str) -> State:
    """The part of a state that `prefixed` made; empty if there is none."""
    start = f"{prefix}."
    return {name.removeprefix(start): array for name, array in state.items() if name.startswith(start)}
