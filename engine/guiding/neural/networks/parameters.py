# SPDX-License-Identifier: GPL-3.0-or-later
"""A network's parameters as one vector: the arrays within it, what they are before training, and sizes in range."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Mapping

import numpy as np

from engine.array_types import Float32Array

#: Features that are learned begin this close to zero, evenly on both sides.
TABLE_LIMIT = 1e-4


class ParameterVector(ABC):
    """Base class of shapes: arrays of parameters in one vector, in the order of `layout`."""

    @property
    @abstractmethod
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector."""
        return sum(math.prod(shape) for shape in self.layout.values())

    def split(self, parameters: Float32Array) -> dict[str, Float32Array]:
        """Views of the arrays of `layout` into one vector of `parameter_count` floats."""
        arrays, start = {}, 0
        for name, shape in self.layout.items():
            stop = start + math.prod(shape)
            arrays[name] = parameters[start:stop].reshape(shape)
            start = stop
        return arrays


def check_sizes(shape: object, limits: Mapping[str, tuple[float, float]]) -> None:
    """Refuse a shape whose sizes are out of range, or whose `width` is no multiple of 8.

    Parameters
    ----------
    shape : object
    limits : mapping
        Least and most by name of attribute.

    Raises
    ------
    ValueError
        Naming the size that is out of range.
    """
    for name, (least, most) in limits.items():
        if not least <= getattr(shape, name) <= most:
            raise ValueError(f"{name} is {getattr(shape, name)}: choose {least} to {most}")
    width: int = shape.width  # type: ignore[attr-defined]
    if width % 8:
        raise ValueError(f"width is {width}: choose a multiple of 8")


def he_limit(input_count: int) -> float:
    """Largest weight of a layer of ReLU with so many inputs before training (He et al. 2015, weights drawn evenly)."""
    return math.sqrt(6.0 / input_count)


def draw_parameters(shape: ParameterVector, seed: int, limits: Mapping[str, float]) -> Float32Array:
    """Parameters before training.

    Parameters
    ----------
    limits : mapping
        By name of array: its entries are drawn evenly from as much below zero to as much above.

    Returns
    -------
    float32 (parameter_count,)
        A function of `shape`, `seed` and `limits` alone.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    parameters = np.zeros(shape.parameter_count, np.float32)
    for name, array in shape.split(parameters).items():
        array[...] = rng.uniform(-limits[name], limits[name], array.shape)
    return parameters
