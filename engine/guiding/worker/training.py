# SPDX-License-Identifier: GPL-3.0-or-later
"""Training the radiance network: relative squared error, Adam.

On the CPU the encodings of grid and planes, their gradients and optimiser are the engine's kernels and torch does the
perceptron; on a GPU torch does everything. Both act on one parameter vector with the layout of `NetworkShape`.

References
----------
Rath et al. 2025, section 5. Lehtinen et al. 2018, "Noise2Noise", section 4 (relative squared error by the prediction,
its gradient stopped: the minimum stays the mean of noisy targets).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from typing import NamedTuple

import numpy as np
import torch

from engine.guiding.encoding import (
    backpropagate_positions,
    backpropagate_u,
    encode_directions,
    encode_positions,
    encode_u,
    make_encoding,
    step_table,
)
from engine.guiding.grids import PLANES
from engine.guiding.network import (
    INNER_EXTENT,
    LOG_RADIANCE_LIMIT,
    NetworkShape,
    Snapshot,
    TrainingSettings,
    initial_parameters,
    robust_bounds,
)
from engine.guiding.worker.samples import VALIDATION_STRIDE, SampleWindow
from engine.scene.arrays import Float32Array

_BETAS = (0.9, 0.99)
_ADAM_EPSILON = 1e-15
#: Radiance that exceeds the prediction by more than so many times the loss's unit is cut in training. The exponential
#: answers a gradient from above far more strongly than one from below: uncut, single bright records throw the field off
#: (docs/experiments.md). What is cut makes the prediction too low, never zero, where light is that rare.
_RESIDUAL_LIMIT = 10.0
_VALIDATION_ROWS = 1 << 14


def encode_positions_torch(
    encoding_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    table: torch.Tensor,
    positions: torch.Tensor,
) -> torch.Tensor:
    """`encode_positions` of encoding.py in torch's operations, for the GPU; differentiable in `table`."""
    u = _contract_torch(positions, center, inverse_extent)
    features = []
    for resolution, offset, is_hashed, mask in encoding_level.tolist():
        x = u * resolution
        cell = x.long().clamp(max=resolution - 1)
        fraction = x - cell
        value = torch.zeros((positions.shape[0], table.shape[1]), device=table.device)
        for corner in range(8):
            step = torch.tensor([corner & 1, (corner >> 1) & 1, corner >> 2], device=cell.device)
            share = torch.where(step > 0, fraction, 1.0 - fraction).prod(dim=1, keepdim=True)
            point = cell + step
            if is_hashed:
                entry = (point[:, 0] ^ (point[:, 1] * 2654435761) ^ (point[:, 2] * 805459861)) & mask
            else:
                entry = (point[:, 2] * (resolution + 1) + point[:, 1]) * (resolution + 1) + point[:, 0]
            value = value + share * table[offset + entry]
        features.append(value)
    return torch.cat(features, dim=1)


def _contract_torch(positions: torch.Tensor, center: torch.Tensor, inverse_extent: torch.Tensor) -> torch.Tensor:
    u = (positions - center) * inverse_extent
    outer = torch.sign(u) * (1.0 - (1.0 - INNER_EXTENT) / u.abs().clamp(min=1.0))
    u = torch.where(u.abs() > 1.0, outer, INNER_EXTENT * u)
    return (0.5 + 0.5 * u).clamp(0.0, 1.0)


def encode_u_torch(
    encoding_plane_level: torch.Tensor,
    center: torch.Tensor,
    inverse_extent: torch.Tensor,
    planes: torch.Tensor,
    frequency_count: int,
    positions: torch.Tensor,
    u: torch.Tensor,
) -> torch.Tensor:
    """`encode_u` of encoding.py in torch's operations, for the GPU; differentiable in `planes`."""
    place = _contract_torch(positions, center, inverse_extent)
    u = u.clamp(0.0, 1.0)
    features = []
    for resolution, offset, _ in encoding_plane_level.tolist():
        for plane in range(PLANES):
            x = torch.stack((place[:, plane], u), dim=1) * resolution
            cell = x.long().clamp(max=resolution - 1)
            fraction = x - cell
            value = torch.zeros((positions.shape[0], planes.shape[1]), device=planes.device)
            for corner in range(4):
                step = torch.tensor([corner & 1, corner >> 1], device=cell.device)
                share = torch.where(step > 0, fraction, 1.0 - fraction).prod(dim=1, keepdim=True)
                point = cell + step
                entry = (plane * (resolution + 1) + point[:, 1]) * (resolution + 1) + point[:, 0]
                value = value + share * planes[offset + entry]
            features.append(value)
    for octave in range(frequency_count):
        angle = math.pi * 2.0**octave * u[:, None]
        features += [torch.sin(angle), torch.cos(angle)]
    return torch.cat(features, dim=1)


class _Features(NamedTuple):
    """A batch as the perceptron sees it: float32 (N, features) each; `u` is None where the network does not see it."""

    position: torch.Tensor
    direction: torch.Tensor
    u: torch.Tensor | None


class _Table:
    """Learned features in training on the CPU, in place: the hash grid, or the planes.

    Parameters
    ----------
    parameters : float32 (entries, features)
    level_count : int
    """

    def __init__(self, parameters: Float32Array, level_count: int) -> None:
        self.parameters = parameters
        self.level_count = level_count
        self.gradient = np.zeros_like(parameters)
        self._moments = np.zeros_like(parameters), np.zeros_like(parameters)

    def step(self, rate: float) -> None:
        """Step what has a gradient."""
        step_table(
            self.parameters, self.gradient, *self._moments, np.float32(rate), np.float32(_BETAS[0]),
            np.float32(_BETAS[1]), np.float32(_ADAM_EPSILON),
        )


class RadianceTraining:
    """The network in training.

    Parameters
    ----------
    shape : NetworkShape
    settings : TrainingSettings
    seed : int
    bounds : float32 (2, 3) [m] or None
        What the grid resolves; None: found from the first records.
    thread_count : int
        Threads to use on the CPU. The result is the same bits for one only.
    device : str
        'cpu' or a device of torch.
    """

    def __init__(
        self,
        shape: NetworkShape,
        settings: TrainingSettings,
        seed: int,
        bounds: Float32Array | None = None,
        thread_count: int = 1,
        device: str = "cpu",
    ) -> None:
        torch.set_num_threads(thread_count)
        self.shape = shape
        self.settings = settings
        self.step_count = 0
        self.rows_received = 0
        self.loss = math.nan
        self.scale = 0.0
        self.bounds = bounds
        self._version = 0
        self._random = np.random.Generator(np.random.Philox(seed))
        self._device = torch.device(device)
        self._pool = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self._thread_count = thread_count
        self._window = SampleWindow(settings.buffer_rows, shape.row_width, settings.window_samples)
        self._validation = SampleWindow(_VALIDATION_ROWS, shape.row_width, settings.window_samples)
        self._reference: torch.Tensor | None = None

        self._parameters = torch.from_numpy(initial_parameters(shape, seed)).to(self._device)
        arrays, start = {}, 0
        for name, sizes in shape.layout.items():
            stop = start + math.prod(sizes)
            arrays[name] = self._parameters[start:stop].view(sizes)
            start = stop
        self._table = arrays.pop("table")
        self._planes = arrays.pop("planes", None)
        self._arrays = {name: array.requires_grad_() for name, array in arrays.items()}
        groups = [
            {"params": list(self._arrays.values()), "lr": settings.learning_rate, "weight_decay": settings.weight_decay}
        ]
        if self._device.type == "cpu":
            self._host_table = _Table(self._table.numpy(), shape.level_count)
            self._host_planes = None if self._planes is None else _Table(self._planes.numpy(), shape.plane_levels)
        else:
            tables = [table.requires_grad_() for table in (self._table, self._planes) if table is not None]
            groups.append({"params": tables, "lr": settings.table_learning_rate})
        self._optimizer = torch.optim.Adam(groups, betas=_BETAS, eps=_ADAM_EPSILON)
        self._base_rates = [group["lr"] for group in self._optimizer.param_groups]

    # Records

    @property
    def can_train(self) -> bool:
        """There are records, and not all of them are black."""
        return self._window.count > 0 and self.scale > 0.0

    @property
    def row_count(self) -> int:
        """Records that training draws from."""
        return self._window.count

    def add(self, rows: Float32Array, samples: float) -> None:
        """Take records of `samples` samples a pixel: float32 (N, row_width), as `channel.pack_rows` writes them."""
        if rows.shape[0] == 0:
            return
        is_validation = (self.rows_received + np.arange(rows.shape[0])) % VALIDATION_STRIDE == 0
        self.rows_received += rows.shape[0]
        self._validation.add(rows[is_validation], samples)
        self._window.add(rows[~is_validation], samples)
        self._reference = None
        if self.bounds is None:
            self.bounds = robust_bounds(rows[:, :3])
        if self.scale == 0.0:
            mean = np.nanmean(self._radiance(rows), axis=1, dtype=np.float64)
            # Without the brightest thousandth, unless nothing else is bright.
            self.scale = float(np.minimum(mean, np.quantile(mean, 0.999)).mean()) or float(mean.mean())
        self._encoding = make_encoding(self.shape, self.bounds, np.zeros(self.shape.parameter_count, np.float32))
        if self._device.type == "cpu":
            self._encoding = self._encoding._replace(table=self._host_table.parameters)
            if self._host_planes is not None:
                self._encoding = self._encoding._replace(planes=self._host_planes.parameters)
        else:
            encoding = self._encoding
            self._tensors = tuple(
                torch.from_numpy(array).to(self._device)
                for array in (encoding.level, encoding.plane_level, encoding.center, encoding.inverse_extent)
            )

    def _radiance(self, rows: Float32Array) -> Float32Array:
        """Radiance of rows: float32 (N, channels), a view."""
        return rows[:, 6 : 6 + self.shape.channel_count]

    # Network

    def _over_rows(self, work: Callable[[int, int], None], count: int) -> None:
        """Call work(start, stop) over ranges of `count`, on all threads."""
        if self._pool is None:
            work(0, count)
            return
        edges = [count * k // self._thread_count for k in range(self._thread_count + 1)]
        list(self._pool.map(work, edges[:-1], edges[1:]))

    def _encode(self, rows: Float32Array) -> _Features:
        """Features of rows."""
        positions = np.ascontiguousarray(rows[:, :3])
        directions = np.ascontiguousarray(rows[:, 3:6])
        encoded_directions = np.empty((rows.shape[0], self.shape.direction_width), np.float32)
        bins = self.shape.direction_bins
        self._over_rows(
            lambda start, stop: encode_directions(directions, bins, start, stop, encoded_directions), rows.shape[0]
        )
        if self._device.type != "cpu":
            return self._encode_torch(rows, torch.from_numpy(encoded_directions).to(self._device))
        encoded_positions = np.empty((rows.shape[0], self.shape.encoding_width), np.float32)
        self._over_rows(
            lambda start, stop: encode_positions(self._encoding, positions, start, stop, encoded_positions),
            rows.shape[0],
        )
        encoded_u = None
        if self.shape.u_width:
            features, u = np.empty((rows.shape[0], self.shape.u_width), np.float32), np.ascontiguousarray(rows[:, -1])
            self._over_rows(
                lambda start, stop: encode_u(self._encoding, positions, u, start, stop, features), rows.shape[0]
            )
            encoded_u = torch.from_numpy(features)
        return _Features(torch.from_numpy(encoded_positions), torch.from_numpy(encoded_directions), encoded_u)

    def _encode_torch(self, rows: Float32Array, directions: torch.Tensor) -> _Features:
        """`_encode` on the device, which has the directions already."""
        level, plane_level, center, inverse_extent = self._tensors
        on_device = torch.from_numpy(rows).to(self._device)
        positions = on_device[:, :3]
        encoded_u = None
        if self.shape.u_width:
            planes = self._planes if self._planes is not None else self._table[:0]
            encoded_u = encode_u_torch(
                plane_level, center, inverse_extent, planes, self.shape.u_frequencies, positions, on_device[:, -1]
            )
        encoded = encode_positions_torch(level, center, inverse_extent, self._table, positions)
        return _Features(encoded, directions, encoded_u)

    def _perceptron(self, features: _Features) -> torch.Tensor:
        """Radiance in units of `scale` from features: (N, channels)."""
        arrays = self._arrays
        value = torch.addmm(
            features.position @ arrays["position_weights"], features.direction, arrays["direction_weights"]
        )
        if features.u is not None:
            value = torch.addmm(value, features.u, arrays["u_weights"])
        value = torch.relu(value)
        for weights in arrays["hidden_weights"]:
            value = torch.relu(value @ weights)
        value = value @ arrays["output_weights"]
        return torch.exp(torch.clamp(value, -LOG_RADIANCE_LIMIT, LOG_RADIANCE_LIMIT))

    def predict(self, rows: Float32Array) -> Float32Array:
        """Radiance at the positions and directions of rows, float32 (N, channels): what `inference` must give too."""
        with torch.no_grad():
            return (self._perceptron(self._encode(rows)) * self.scale).cpu().numpy()

    def _targets(self, rows: Float32Array, prediction: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Radiance to learn, in units of `scale`, and the unit of its error: sqrt(prediction^2 + epsilon), (N, 1).

        Radiance that is not known is NaN.
        """
        unit = (prediction.mean(dim=1, keepdim=True).square() + self.settings.epsilon).sqrt()
        targets = torch.from_numpy(self._radiance(rows) * np.float32(1.0 / self.scale)).to(self._device)
        if not self.shape.by_quarter:
            return torch.minimum(targets, prediction + _RESIDUAL_LIMIT * unit), unit
        # Behind smooth refraction one wavelength has the light of all four: cut alone it would lose more than they do.
        is_known = ~torch.isnan(targets)
        known = is_known.sum(dim=1, keepdim=True)
        predicted = torch.where(is_known, prediction, 0.0).sum(dim=1, keepdim=True) / known
        mean = torch.nanmean(targets, dim=1, keepdim=True).clamp(min=1e-20)
        return targets * ((predicted + _RESIDUAL_LIMIT * unit) / mean).clamp(max=1.0), unit

    def _error(self, prediction: torch.Tensor, targets: torch.Tensor, unit: torch.Tensor) -> torch.Tensor:
        """Mean relative squared error of what is known: ()."""
        if not self.shape.by_quarter:
            return ((prediction - targets) / unit).square().mean()
        is_known = ~torch.isnan(targets)
        # Before the square, whose gradient at NaN is NaN even where it is not asked for.
        residual = torch.where(is_known, prediction - targets, 0.0) / unit
        return residual.square().sum() / is_known.sum()

    def step(self) -> None:
        """One step of training on a random batch."""
        settings = self.settings
        rows = self._window.take(self._random.integers(0, self._window.count, settings.batch_size))
        features = self._encode(rows)
        on_cpu = self._device.type == "cpu"
        if on_cpu:
            features.position.requires_grad_()
            if features.u is not None:
                features.u.requires_grad_(self._planes is not None)
        prediction = self._perceptron(features)
        targets, unit = self._targets(rows, prediction.detach())
        loss = self._error(prediction, targets, unit)
        self._optimizer.zero_grad()
        loss.backward()
        self._optimizer.step()
        self.step_count += 1
        if on_cpu:
            self._step_tables(rows, features)

    def _step_tables(self, rows: Float32Array, features: _Features) -> None:
        """Carry the gradients of features on to the grid and the planes, and step them."""
        correction = math.sqrt(1.0 - _BETAS[1] ** self.step_count) / (1.0 - _BETAS[0] ** self.step_count)
        rate = self.settings.table_learning_rate * correction
        positions, row_count = np.ascontiguousarray(rows[:, :3]), rows.shape[0]
        table, planes = self._host_table, self._host_planes
        if features.position.grad is not None:
            gradient = features.position.grad.numpy()
            self._over_rows(
                lambda first, last: backpropagate_positions(
                    self._encoding, positions, row_count, gradient, first, last, table.gradient
                ),
                table.level_count,
            )
            table.step(rate)
        if planes is not None and features.u is not None and features.u.grad is not None:
            u, u_gradient = np.ascontiguousarray(rows[:, -1]), features.u.grad.numpy()
            self._over_rows(
                lambda first, last: backpropagate_u(
                    self._encoding, positions, u, row_count, u_gradient, first, last, planes.gradient
                ),
                planes.level_count,
            )
            planes.step(rate)

    # Progress

    def improvement(self) -> float:
        """How far the loss on held-out records fell since the last call, as a fraction of it.

        Both predictions are weighted by the earlier one, so the noise of the targets cancels in the difference. After
        new records it is infinite: there is nothing to compare with.
        """
        rows = self._validation.take(np.arange(self._validation.count))
        if rows.shape[0] == 0:
            return math.inf
        with torch.no_grad():
            prediction = self._perceptron(self._encode(rows))
            previous, self._reference = self._reference, prediction
            targets, unit = self._targets(rows, prediction if previous is None else previous)
            error = self._error(prediction, targets, unit).item()
            self.loss = error
            if previous is None:
                return math.inf
            earlier = self._error(previous, targets, unit).item()
        return (earlier - error) / max(earlier, 1e-12)

    def snapshot(self) -> Snapshot:
        """The network as it is; its parameters are a view that the next step changes."""
        if self.bounds is None or self.scale <= 0.0:
            raise ValueError("no snapshot before the first records with light")
        self._version += 1
        parameters = self._parameters.detach().cpu().numpy()
        return Snapshot(self._version, self.step_count, self.loss, self.scale, self.bounds, parameters)
