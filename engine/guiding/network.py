# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network: its shape, its parameters as one vector, and the snapshot that carries them.

Position and direction to incident radiance, as in section 5 of the paper: a hash grid over position, one-blob encoding
of the direction, hidden layers of ReLU without bias, and an exponential that keeps the output positive. Everything that
trains or evaluates the network agrees through this module; it does not know torch.

References
----------
Rath et al. 2025, "Neural Resampling with Optimized Candidate Allocation", sections 3 and 5.
Müller et al. 2022, "Instant Neural Graphics Primitives", section 3 (hash grid).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import ClassVar, Protocol

import numpy as np

from engine.scene.arrays import Float32Array

#: The network's last layer is clamped to this before the exponential: radiance within e^±10 of the records' mean.
LOG_RADIANCE_LIMIT = 10.0
#: Space along each axis that the bounds take in the unit cube; the rest holds everything outside (`encoding.py`).
INNER_EXTENT = 0.9


def split_parameters(layout: dict[str, tuple[int, ...]], parameters: Float32Array) -> dict[str, Float32Array]:
    """Views into one vector of the arrays whose names and shapes `layout` holds in their order."""
    arrays, start = {}, 0
    for name, shape in layout.items():
        stop = start + math.prod(shape)
        arrays[name] = parameters[start:stop].reshape(shape)
        start = stop
    return arrays


class TrainableShape(Protocol):
    """What the trainer, the channel and snapshots ask of the shape of any network; a dataclass of plain values.

    kind : names its training in the worker (`worker/service.py`)
    """

    kind: ClassVar[str]

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs."""

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector."""

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said."""


@dataclass(frozen=True)
class NetworkShape:
    """Sizes of the network; the defaults are the paper's.

    level_count, level_features : levels of the hash grid and features of each
    base_resolution, finest_resolution : cells along an axis of the coarsest and the finest level
    table_size : entries of a level at most, a power of two
    direction_bins : one-blob bins for each of a direction's three coordinates
    width, hidden_layers : of the perceptron
    channel_count : of the spectrum

    Raises
    ------
    ValueError
        Naming the size that is out of range.
    """

    level_count: int = 8
    level_features: int = 4
    base_resolution: int = 8
    finest_resolution: int = 2048
    table_size: int = 1 << 16
    direction_bins: int = 8
    width: int = 64
    hidden_layers: int = 3
    channel_count: int = 3

    kind: ClassVar[str] = "RADIANCE"

    def __post_init__(self) -> None:
        limits = {
            "level_count": (1, 16),
            "level_features": (1, 8),
            "base_resolution": (1, 256),
            "finest_resolution": (self.base_resolution, 1 << 15),
            "table_size": (8, 1 << 22),
            "direction_bins": (3, 64),
            "width": (8, 128),
            "hidden_layers": (1, 8),
            "channel_count": (1, 16),
        }
        for name, (least, most) in limits.items():
            if not least <= getattr(self, name) <= most:
                raise ValueError(f"{name} is {getattr(self, name)}: choose {least} to {most}")
        if self.table_size & (self.table_size - 1):
            raise ValueError(f"table_size is {self.table_size}: choose a power of two")
        if self.level_features % 2:
            raise ValueError(f"level_features is {self.level_features}: choose an even number")
        if self.width % 8:
            raise ValueError(f"width is {self.width}: choose a multiple of 8")

    @property
    def resolutions(self) -> tuple[int, ...]:
        """Cells along an axis of each level: a geometric series (Müller et al. 2022, Eqs. 2 and 3)."""
        if self.level_count == 1:
            return (self.base_resolution,)
        growth = math.log(self.finest_resolution / self.base_resolution) / (self.level_count - 1)
        return tuple(round(self.base_resolution * math.exp(level * growth)) for level in range(self.level_count))

    @property
    def level_offsets(self) -> tuple[int, ...]:
        """First entry of each level in the table, and the number of all entries at the end."""
        offsets = [0]
        for resolution in self.resolutions:
            offsets.append(offsets[-1] + min((resolution + 1) ** 3, self.table_size))
        return tuple(offsets)

    @property
    def encoding_width(self) -> int:
        """Features of an encoded position."""
        return self.level_count * self.level_features

    @property
    def direction_width(self) -> int:
        """Features of an encoded direction."""
        return 3 * self.direction_bins

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs: position, direction, radiance."""
        return 6 + self.channel_count

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said."""
        return TrainingSettings()

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""
        return {
            "table": (self.level_offsets[-1], self.level_features),
            "position_weights": (self.encoding_width, self.width),
            "direction_weights": (self.direction_width, self.width),
            "hidden_weights": (self.hidden_layers - 1, self.width, self.width),
            "output_weights": (self.width, self.channel_count),
        }

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector."""
        return sum(math.prod(shape) for shape in self.layout.values())

    def split(self, parameters: Float32Array) -> dict[str, Float32Array]:
        """Views of the arrays of `layout` into one vector of `parameter_count` floats."""
        return split_parameters(self.layout, parameters)


#: A network for processors without a GPU beside them: no worse than the paper's after a million records, at a third of
#: its cost to train (docs/experiments.md).
COMPACT_SHAPE = NetworkShape(
    level_count=4, finest_resolution=64, table_size=1 << 14, direction_bins=16, width=32, hidden_layers=2
)

#: By the setting `network_size`.
NETWORK_SHAPES = {"COMPACT": COMPACT_SHAPE, "PAPER": NetworkShape()}


def network_shape(size: str, channel_count: int) -> NetworkShape:
    """The shape of a size (`NETWORK_SHAPES`) for a spectrum's width."""
    return replace(NETWORK_SHAPES[size], channel_count=channel_count)


@dataclass(frozen=True)
class TrainingSettings:
    """How the network is trained; weight decay and window are the paper's, the learning rate is ten times its 1e-3.

    batch_size : records a step
    learning_rate, table_learning_rate : of Adam, for the perceptron and for the hash grid. On a
        processor training sees few records: at 1e-3 the perceptron has learned little by the end (docs/experiments.md)
    weight_decay : of the perceptron (the grid has none: entries without records keep what they have)
    epsilon : added to the squared prediction in the loss, for radiance in units of `Snapshot.scale`
    window_samples : records of so many samples a pixel are kept, the oldest go first
    buffer_rows : records kept at most
    submission_rows : records taken from one `submit`; more are thinned at random
    epochs : times that a record is looked at on average before training waits for the next ones
    snapshot_seconds : between two snapshots while training
    """

    batch_size: int = 4096
    learning_rate: float = 1e-2
    table_learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    epsilon: float = 0.01
    window_samples: float = 24.0
    buffer_rows: int = 1 << 20
    submission_rows: int = 1 << 18
    epochs: float = 4.0
    snapshot_seconds: float = 1.0


@dataclass(frozen=True)
class Snapshot:
    """The network as it was after `step` steps of training.

    version : grows with every snapshot of a training
    step : steps of training so far
    loss : relative squared error on records kept out of training; NaN before any were seen
    scale : radiance that the network's unit stands for
    bounds : float32 (2, 3), lower and upper corner [m] of what the grid resolves
    parameters : float32 (parameter_count,)
    """

    version: int
    step: int
    loss: float
    scale: float
    bounds: Float32Array
    parameters: Float32Array = field(repr=False)

    def validate(self, shape: TrainableShape) -> None:
        """Refuse what must not reach the renderer.

        Raises
        ------
        ValueError
            If a size is not that of `shape`, or anything the prediction depends on is not finite.
        """
        if self.parameters.shape != (shape.parameter_count,) or self.parameters.dtype != np.float32:
            raise ValueError(f"snapshot {self.version}: expected {shape.parameter_count} float32 parameters")
        if self.bounds.shape != (2, 3) or not np.isfinite(self.bounds).all():
            raise ValueError(f"snapshot {self.version}: bounds are not two finite points")
        if (self.bounds[1] <= self.bounds[0]).any():
            raise ValueError(f"snapshot {self.version}: bounds are empty")
        if not (math.isfinite(self.scale) and self.scale > 0.0):
            raise ValueError(f"snapshot {self.version}: scale is {self.scale}")
        # One pass: a sum of finite float32 in float64 cannot overflow, and NaN and infinity survive it.
        if not math.isfinite(float(np.sum(self.parameters, dtype=np.float64))):
            raise ValueError(f"snapshot {self.version}: parameters are not finite")


def initial_parameters(shape: NetworkShape, seed: int) -> Float32Array:
    """Parameters before training: a grid next to zero, He-initialised layers, radiance of about one unit anywhere.

    Returns
    -------
    float32 (parameter_count,)
        A function of `shape` and `seed` alone.
    """
    rng = np.random.Generator(np.random.Philox(seed))
    parameters = np.zeros(shape.parameter_count, np.float32)
    arrays = shape.split(parameters)
    fan_in = shape.encoding_width + shape.direction_width
    for name, array in arrays.items():
        if name == "table":
            limit = 1e-4
        elif name == "output_weights":
            # A tenth of He's: the first prediction is nearly constant.
            limit = 0.1 * math.sqrt(6.0 / shape.width)
        else:
            limit = math.sqrt(6.0 / (fan_in if name != "hidden_weights" else shape.width))
        array[...] = rng.uniform(-limit, limit, array.shape)
    return parameters


def robust_bounds(positions: Float32Array, margin: float = 0.05) -> Float32Array:
    """Box of all but the outermost positions.

    Parameters
    ----------
    positions : float32 (N, 3) [m]
        Those that are not finite are left out.
    margin : float
        Added on each side, as a fraction of the box.

    Returns
    -------
    float32 (2, 3)
        From the 0.5th to the 99.5th percentile along each axis, and never empty: a horizon must not cost the room its
        resolution.
    """
    finite = positions[np.isfinite(positions).all(axis=1)].astype(np.float64)
    if finite.shape[0] == 0:
        return np.array(((-1.0,) * 3, (1.0,) * 3), np.float32)
    # The percentiles of 64k positions are as good as those of all.
    finite = finite[:: max(1, finite.shape[0] >> 16)]
    lower, upper = np.percentile(finite, (0.5, 99.5), axis=0)
    extent = upper - lower
    # A flat scene is resolved in its plane; a millionth of the coordinates is all that float32 tells apart.
    least = max(float(extent.max()) * 1e-3, float(np.abs(finite).max()) * 1e-6, 1e-6)
    padding = np.maximum(extent * margin, 0.5 * (least - extent))
    return np.stack((lower - padding, upper + padding)).astype(np.float32)
