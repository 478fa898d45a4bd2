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

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from engine.array_types import Float32Array
from engine.guiding.networks.encoding import (
    Encoding,
    backpropagate_positions,
    backpropagate_u,
    encode_directions,
    encode_positions,
    encode_u,
    make_encoding,
)
from engine.guiding.networks.radiance import (
    LOG_RADIANCE_LIMIT,
    NetworkShape,
    TrainingSettings,
    initial_parameters,
)
from engine.guiding.worker.tables import ADAM_EPSILON, BETAS, LearnedTable
from engine.guiding.worker.torch_encoding import encode_positions_torch, encode_u_torch
from engine.guiding.worker.training import Training, split_tensor

#: Radiance that exceeds the prediction by more than so many times the loss's unit is cut in training. The exponential
#: answers a gradient from above far more strongly than one from below: uncut, single bright records throw the field off
#: (docs/decisions/radiance-network.md). What is cut makes the prediction too low, never zero, where light is that rare.
_RESIDUAL_LIMIT = 10.0


class _Features(NamedTuple):
    """A batch as the perceptron sees it: float32 (N, features) each; `u` is None where the network does not see it."""

    position: torch.Tensor
    direction: torch.Tensor
    u: torch.Tensor | None


class RadianceTraining(Training):
    """The radiance network in training; parameters as in `Training`.

    Parameters
    ----------
    device : str
        'cpu' or a device of torch.
    """

    shape: NetworkShape
    _encoding: Encoding

    def __init__(
        self, shape: NetworkShape, settings: TrainingSettings, seed: int, bounds: Float32Array | None = None,
        thread_count: int = 1, device: str = "cpu",
    ) -> None:
        super().__init__(shape, settings, seed, bounds, thread_count)
        self._device = torch.device(device)
        self._parameters = torch.from_numpy(initial_parameters(shape, seed)).to(self._device)
        arrays = split_tensor(shape, self._parameters)
        tables = {name: arrays.pop(name) for name in ("table", "planes") if name in arrays}
        self._grid, self._planes = tables["table"], tables.get("planes")
        self._arrays = {name: array.requires_grad_() for name, array in arrays.items()}
        groups = [
            {"params": list(self._arrays.values()), "lr": settings.learning_rate, "weight_decay": settings.weight_decay}
        ]
        if self._device.type == "cpu":
            levels = {"table": shape.level_count, "planes": shape.plane_levels}
            backpropagate = {"table": backpropagate_positions, "planes": backpropagate_u}
            self._tables = [
                LearnedTable(
                    table.numpy(), backpropagate[name], level_count=levels[name],
                    learning_rate=settings.table_learning_rate,
                )
                for name, table in tables.items()
            ]
        else:
            groups.append(
                {"params": [t.requires_grad_() for t in tables.values()], "lr": settings.table_learning_rate}
            )
        self._optimizer = torch.optim.Adam(groups, betas=BETAS, eps=ADAM_EPSILON)

    def _prepare(self, rows: Float32Array, bounds: Float32Array) -> None:
        if self.scale == 0.0:
            mean = np.nanmean(self._radiance(rows), axis=1, dtype=np.float64)
            # Without the brightest thousandth, unless nothing else is bright.
            self.scale = float(np.minimum(mean, np.quantile(mean, 0.999)).mean()) or float(mean.mean())
        # On the CPU these are views of the parameters in training.
        self._encoding = make_encoding(self.shape, bounds, self._parameters.detach().cpu().numpy())
        if self._device.type != "cpu":
            encoding = self._encoding
            self._tensors = tuple(
                torch.from_numpy(array).to(self._device)
                for array in (encoding.level, encoding.plane_level, encoding.center, encoding.inverse_extent)
            )

    def _radiance(self, rows: Float32Array) -> Float32Array:
        """Radiance of rows: float32 (N, channels), a view."""
        return rows[:, 6 : 6 + self.shape.channel_count]

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
        encoded_positions = np.empty((rows.shape[0], self.shape.position_width), np.float32)
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
            planes = self._planes if self._planes is not None else self._grid[:0]
            encoded_u = encode_u_torch(
                plane_level, center, inverse_extent, planes, self.shape.u_frequencies, positions, on_device[:, -1]
            )
        encoded = encode_positions_torch(level, center, inverse_extent, self._grid, positions)
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

    def _loss(self, rows: Float32Array) -> tuple[torch.Tensor, Sequence[torch.Tensor]]:
        features = self._encode(rows)
        # There is no table of planes where u is seen by frequencies alone, and none at all on a GPU.
        learned = [
            tensor.requires_grad_()
            for tensor, _ in zip((features.position, features.u), self._tables, strict=False)
            if tensor is not None
        ]
        prediction = self._perceptron(features)
        return self._error(prediction, *self._targets(rows, prediction.detach())), learned

    def _answer(self, rows: Float32Array) -> torch.Tensor:
        return self._perceptron(self._encode(rows))

    def _judge(self, rows: Float32Array, answer: torch.Tensor, previous: torch.Tensor) -> tuple[float, float]:
        """Relative squared error, and how far it fell, as a fraction of the previous one.

        Both are weighted by the previous prediction, so the noise of the targets cancels in the difference.
        """
        targets, unit = self._targets(rows, previous)
        error = self._error(answer, targets, unit).item()
        earlier = self._error(previous, targets, unit).item()
        return error, (earlier - error) / max(earlier, 1e-12)

    def _snapshot_parameters(self) -> Float32Array:
        return self._parameters.detach().cpu().numpy()
