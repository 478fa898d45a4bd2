# SPDX-License-Identifier: GPL-3.0-or-later
"""A network's parameters among a graph's initialisers, and back into the vector that they were."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.onnx_files.graph import GraphBuilder
from engine.guiding.neural.networks.parameters import ParameterVector

#: The array of a shape's layout that holds several layers of one size: each is an initialiser of its own.
_HIDDEN = "hidden_weights"


def _names(shape: ParameterVector) -> Iterator[tuple[str, str, tuple[int, ...]]]:
    """Array of the layout, name of the initialiser, and the initialiser's shape, in the order of the vector."""
    for name, sizes in shape.layout.items():
        if name != _HIDDEN:
            yield name, name, sizes
        else:
            yield from ((name, f"{name}_{index}", sizes[1:]) for index in range(sizes[0]))


def add_parameters(graph: GraphBuilder, shape: ParameterVector, parameters: Float32Array) -> dict[str, list[str]]:
    """Make a vector of parameters a graph's initialisers.

    Returns
    -------
    dict
        By array of the shape's layout, the names of its initialisers: one, and of the hidden layers one each.
    """
    names: dict[str, list[str]] = {name: [] for name in shape.layout}
    start = 0
    for array, name, sizes in _names(shape):
        stop = start + math.prod(sizes)
        names[array].append(graph.initialiser(name, parameters[start:stop].reshape(sizes)))
        start = stop
    return names


def gather_parameters(shape: ParameterVector, initialisers: Mapping[str, np.ndarray]) -> Float32Array:
    """The vector that `add_parameters` was given: float32 (parameter_count,), a copy.

    Raises
    ------
    ValueError
        If an array is missing or is not of the shape's sizes. Nothing is allocated before all have been looked at.
    """
    arrays = []
    for _, name, sizes in _names(shape):
        array = initialisers.get(name)
        if array is None:
            raise ValueError(f"it has no {name}")
        if array.shape != sizes or array.dtype != np.float32:
            raise ValueError(f"its {name} are {array.dtype} {array.shape}, of its shape they would be float32 {sizes}")
        arrays.append(array.ravel())
    return np.concatenate(arrays)
