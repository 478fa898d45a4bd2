# SPDX-License-Identifier: GPL-3.0-or-later
"""The radiance network: its shape, its parameters as one vector, and the snapshot that carries them.

Position and direction to incident radiance, as in section 5 of the paper: a hash grid over position, one-blob encoding
of the direction, hidden layers of ReLU without bias, and an exponential that keeps the output positive. Where light
depends on more, on the time or the wavelength, the network may see that too: u in [0, 1]. Everything that trains or
evaluates the network agrees through this module; it does not know torch.

References
----------
Rath et al. 2025, "Neural Resampling with Optimized Candidate Allocation", sections 3 and 5.
Müller et al. 2022, "Instant Neural Graphics Primitives", section 3 (hash grid).
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", sections 4.1 and 6.2 (a further dimension u).
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from itertools import accumulate
from typing import Any, ClassVar, Protocol

import numpy as np

from engine.array_types import Float32Array
from engine.guiding.neural.networks.parameters import (
    TABLE_LIMIT,
    ParameterVector,
    check_sizes,
    draw_parameters,
    he_limit,
)
from engine.settings import RenderSettings
from engine.spectral.wavelengths import WAVELENGTH_COUNT

#: The network's last layer is clamped to this before the exponential: radiance within e^±10 of the records' mean.
LOG_RADIANCE_LIMIT = 10.0
#: Space along each axis that the bounds take in the unit cube; the rest holds everything outside (`encoding.py`).
INNER_EXTENT = 0.9
#: Positions further out than this [m] are as far as bounds can tell: their differences stay within float32.
_FARTHEST = 1e15
#: How u is seen, by setting (`settings.U_ENCODINGS`): few octaves and coarse planes, that a render on a processor can
#: train (docs/decisions/time-and-wavelengths.md).
COARSE_U_ENCODINGS: dict[str, dict[str, Any]] = {
    "NONE": {},
    "FREQUENCY": {"u_frequencies": 4},
    "PLANES": {"plane_levels": 3, "plane_resolution": 4},
}
#: The same within a quarter of the wavelengths: as fine, so two octaves or levels fewer.
_QUARTER_U_ENCODINGS: dict[str, dict[str, Any]] = {
    "FREQUENCY": {"u_frequencies": 2},
    "PLANES": {"plane_levels": 1, "plane_resolution": 4},
}


def grid_resolutions(base: int, growth: float, count: int) -> tuple[int, ...]:
    """Cells along an axis of so many grids: a geometric series of whole numbers."""
    return tuple(math.floor(base * growth**level) for level in range(count))


def grid_offsets(sizes: Iterable[int]) -> tuple[int, ...]:
    """Where parts of so many entries begin, one after the other, and where the last one ends."""
    return (0, *accumulate(sizes))


class PlaneSizes:
    """Sizes of planes of learned features (x, u), (y, u) and (z, u), of a shape that says which."""

    plane_levels: int
    plane_features: int
    plane_resolution: int
    plane_growth: float

    @property
    def plane_resolutions(self) -> tuple[int, ...]:
        """Cells along an axis of each level of the planes."""
        return grid_resolutions(self.plane_resolution, self.plane_growth, self.plane_levels)

    @property
    def plane_offsets(self) -> tuple[int, ...]:
        """First entry of each level's planes in their table, and the number of all entries at the end."""
        return grid_offsets(3 * (resolution + 1) ** 2 for resolution in self.plane_resolutions)

    @property
    def plane_width(self) -> int:
        """Features of the planes."""
        return 3 * self.plane_levels * self.plane_features


class TrainableShape(Protocol):
    """What the trainer, the channel and snapshots ask of the shape of any network; a dataclass of plain values.

    kind : names its training in the worker (`worker/kinds.py`)
    """

    kind: ClassVar[str]

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs."""

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""

    @property
    def parameter_count(self) -> int:
        """Length of the parameter vector."""

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said."""


@dataclass(frozen=True)
class NetworkShape(PlaneSizes, ParameterVector):
    """Sizes of the network; the defaults are the paper's.

    level_count, level_features : levels of the hash grid and features of each
    base_resolution, finest_resolution : cells along an axis of the coarsest and the finest level
    table_size : entries of a level at most, a power of two
    direction_bins : one-blob bins for each of a direction's three coordinates
    width, hidden_layers : of the perceptron
    channel_count : of the spectrum
    u_frequencies : octaves of the frequency encoding of u, 0 = none
    plane_levels, plane_features : levels of the three planes of learned features (x, u), (y, u) and (z, u), 0 = none;
        and features of each plane and level
    plane_resolution, plane_growth : cells along an axis of the coarsest planes, and by how much each next one is finer
    by_quarter : whether outputs belong to the quarters that wavelengths' numbers lie in, and u is how far within
        (`wavelengths.hero_quarter`); else to the channels of paths. A row may know the radiance of some alone

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
    u_frequencies: int = 0
    plane_levels: int = 0
    plane_features: int = 2
    plane_resolution: int = 4
    plane_growth: float = 2.0
    by_quarter: bool = False

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
            "u_frequencies": (0, 16),
            "plane_levels": (0, 10),
            "plane_features": (2, 8),
            "plane_resolution": (1, 128),
            "plane_growth": (1.0, 4.0),
        }
        check_sizes(self, limits)
        if self.table_size & (self.table_size - 1):
            raise ValueError(f"table_size is {self.table_size}: choose a power of two")
        if self.by_quarter and self.channel_count != WAVELENGTH_COUNT:
            raise ValueError(f"channel_count is {self.channel_count}: by quarter, choose {WAVELENGTH_COUNT}")
        for name in ("level_features", "plane_features"):
            if getattr(self, name) % 2:
                raise ValueError(f"{name} is {getattr(self, name)}: choose an even number")
        if self.u_width > 128:
            raise ValueError(f"plane_levels is {self.plane_levels}: of u there are {self.u_width} features, choose 128")

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
        return grid_offsets(min((resolution + 1) ** 3, self.table_size) for resolution in self.resolutions)

    @property
    def position_width(self) -> int:
        """Features of an encoded position."""
        return self.level_count * self.level_features

    @property
    def direction_width(self) -> int:
        """Features of an encoded direction."""
        return 3 * self.direction_bins

    @property
    def u_width(self) -> int:
        """Features of u: those of the planes, then the frequencies'. 0 where it is not seen."""
        return self.plane_width + 2 * self.u_frequencies

    @property
    def row_width(self) -> int:
        """Floats of a record that training needs: position, direction, radiance, and u where it is seen."""
        return 6 + self.channel_count + (1 if self.u_width else 0)

    @property
    def training_settings(self) -> TrainingSettings:
        """How it is trained if nothing else is said."""
        return U_TRAINING_SETTINGS if self.u_width else TrainingSettings()

    @property
    def layout(self) -> dict[str, tuple[int, ...]]:
        """Name and shape of each array of parameters, in the order of the parameter vector."""
        layout: dict[str, tuple[int, ...]] = {"table": (self.level_offsets[-1], self.level_features)}
        if self.plane_levels:
            layout["planes"] = (self.plane_offsets[-1], self.plane_features)
        layout["position_weights"] = (self.position_width, self.width)
        layout["direction_weights"] = (self.direction_width, self.width)
        if self.u_width:
            layout["u_weights"] = (self.u_width, self.width)
        layout["hidden_weights"] = (self.hidden_layers - 1, self.width, self.width)
        layout["output_weights"] = (self.width, self.channel_count)
        return layout


#: A network for processors without a GPU beside them: no worse than the paper's after a million records, at a third of
#: its cost to train (docs/decisions/radiance-network.md).
COMPACT_SHAPE = NetworkShape(
    level_count=4, finest_resolution=64, table_size=1 << 14, direction_bins=16, width=32, hidden_layers=2
)

#: By the setting `network_size`.
NETWORK_SHAPES = {"COMPACT": COMPACT_SHAPE, "PAPER": NetworkShape()}


def network_shape(settings: RenderSettings) -> NetworkShape:
    """The shape that settings ask for."""
    shape = replace(NETWORK_SHAPES[settings.network_size], channel_count=settings.channel_count)
    is_wavelength = settings.u_dimension == "WAVELENGTH"
    encoding = settings.network_u
    if encoding == "AUTO":
        encoding = "FREQUENCY" if is_wavelength else "NONE"
    if is_wavelength and encoding != "NONE":
        return replace(shape, by_quarter=True, **_QUARTER_U_ENCODINGS[encoding])
    return replace(shape, **COARSE_U_ENCODINGS[encoding])


@dataclass(frozen=True)
class TrainingSettings:
    """How the network is trained; weight decay is the paper's, the learning rate is ten times its 1e-3.

    batch_size : records a step
    learning_rate, table_learning_rate : of Adam, for the perceptron and for the hash grid. On a
        processor training sees few records: at 1e-3 the perceptron has learned little by the end
        (docs/decisions/radiance-network.md)
    weight_decay : of the perceptron (the grid has none: entries without records keep what they have)
    buffer_rows : records kept at most, of all iterations alike
    submission_rows : records taken from one `submit`; more are thinned at random
    epochs : times that a record is looked at on average before training waits for the next ones
    snapshot_seconds : between two snapshots while training
    first_snapshot_seconds : from the first records to the first snapshot, unless training is done before
    device : what trains, as the render setting `training_device` has it
    """

    batch_size: int = 4096
    learning_rate: float = 1e-2
    table_learning_rate: float = 1e-3
    weight_decay: float = 1e-5
    buffer_rows: int = 1 << 20
    submission_rows: int = 1 << 18
    epochs: float = 4.0
    snapshot_seconds: float = 1.0
    first_snapshot_seconds: float = 0.3
    device: str = "AUTO"


#: Where u is seen there is more to learn from as many records, and light that comes and goes.
U_TRAINING_SETTINGS = TrainingSettings(learning_rate=3e-3)


@dataclass(frozen=True)
class Snapshot:
    """The network as it was after `step` steps of training.

    version : grows with every snapshot of a training
    step : steps of training so far
    loss : of the training, on records kept out of it; NaN before any were seen
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
    """Parameters before training: grids next to zero, He-initialised layers, radiance of about one unit anywhere.

    Returns
    -------
    float32 (parameter_count,)
        A function of `shape` and `seed` alone.
    """
    inputs = dict.fromkeys(
        ("position_weights", "direction_weights", "u_weights"),
        he_limit(shape.position_width + shape.direction_width + shape.u_width),
    )
    hidden = he_limit(shape.width)
    return draw_parameters(shape, seed, {
        "table": TABLE_LIMIT, "planes": TABLE_LIMIT, **inputs, "hidden_weights": hidden,
        # The first prediction is nearly constant.
        "output_weights": 0.1 * hidden,
    })  # fmt: skip


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
    finite = positions[np.isfinite(positions).all(axis=1)].clip(-_FARTHEST, _FARTHEST).astype(np.float64)
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
