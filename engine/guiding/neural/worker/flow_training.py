# SPDX-License-Identifier: GPL-3.0-or-later
"""Training the flow: divergence from the target by weighted records, Adam.

Records were drawn with known densities from whatever guided then, so each weighs target / pdf. What has no target
teaches nothing under either divergence and is not kept.

References
----------
Müller et al. 2019, "Neural Importance Sampling", sections 5.1 (Kullback-Leibler) and 5.2 (chi-square).
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import torch

from engine.array_types import Float32Array
from engine.guiding.neural.networks.flow.field import FlowField, view_flow_field
from engine.guiding.neural.networks.flow.query import encode_flow_rows
from engine.guiding.neural.networks.flow.shape import (
    ACTIVATION_LIMIT,
    LOGIT_LIMIT,
    MIN_WIDTH,
    UNIFORM_SHARE,
    FlowSettings,
    FlowShape,
    initial_flow_parameters,
)
from engine.guiding.neural.worker.adam import Adam, Group
from engine.guiding.neural.worker.devices import PROCESSOR, Device, Rows
from engine.guiding.neural.worker.torch_encoding import contract_torch, one_blob
from engine.guiding.neural.worker.training import Training, split_tensor
from engine.guiding.records.training_rows import (
    ROW_NORMAL,
    ROW_PDF,
    ROW_POSITION,
    ROW_RADIANCE,
    ROW_REFLECTANCE,
    ROW_ROUGHNESS,
    ROW_WI,
    ROW_WO,
    is_fit,
)
from engine.kernels.constants import ONE_MINUS_EPSILON

#: Densities and targets outside are not kept: their products stay within float64, their logarithms within reason.
_LEAST, _MOST = 1e-30, 1e30


def move(outputs: torch.Tensor, x: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """A coupling layer given its perceptron's outputs (N, 2 K + 1): x (N,) moved, and the logarithm of the density.

    The same as `_shape_layer` and `_move` of flow/query.py.
    """
    bin_count = outputs.shape[1] // 2
    outputs = outputs.clamp(-LOGIT_LIMIT, LOGIT_LIMIT)
    widths = MIN_WIDTH + (1.0 - bin_count * MIN_WIDTH) * torch.softmax(outputs[:, :bin_count], dim=1)
    heights = outputs[:, bin_count:]
    heights = torch.exp(heights - heights.max(dim=1, keepdim=True).values.detach())
    areas = 0.5 * (heights[:, :-1] + heights[:, 1:]) * widths
    scale = (1.0 - UNIFORM_SHARE) / areas.sum(dim=1, keepdim=True)
    heights = UNIFORM_SHARE + scale * heights
    areas = UNIFORM_SHARE * widths + scale * areas
    right_edges = torch.cumsum(widths, dim=1)
    chosen = (right_edges[:, :-1].detach() <= x[:, None].detach()).sum(dim=1, keepdim=True)

    def pick(values: torch.Tensor) -> torch.Tensor:
        return torch.gather(values, 1, chosen)[:, 0]

    width = pick(widths)
    t = ((x - pick(right_edges) + width) / width).clamp(0.0, 1.0)
    height = pick(heights[:, :-1])
    rise = pick(heights[:, 1:]) - height
    y = pick(torch.cumsum(areas, dim=1) - areas) + width * t * (height + 0.5 * rise * t)
    return y.clamp(0.0, 1.0), torch.log(height + rise * t)


def direction_to_square_torch(wi: torch.Tensor) -> torch.Tensor:
    """`direction_to_square` of unit directions (N, 3): (N, 2)."""
    x, y, z = wi.unbind(1)
    below = 0.5 * (x * x + y * y) / (1.0 + z.abs())
    a = torch.where(z >= 0.0, below, 1.0 - below)
    b = torch.atan2(y, x) * (0.5 / math.pi)
    return torch.stack((a, torch.where(b < 0.0, b + 1.0, b)), dim=1).clamp(0.0, float(ONE_MINUS_EPSILON))


class FlowTraining(Training):
    """The flow in training; parameters as in `Training`."""

    shape: FlowShape
    settings: FlowSettings

    def __init__(
        self, shape: FlowShape, settings: FlowSettings, seed: int, bounds: Float32Array | None = None,
        thread_count: int = 1, device: Device = PROCESSOR,
    ) -> None:
        super().__init__(shape, settings, seed, bounds, thread_count, device)
        self._parameters = torch.from_numpy(initial_flow_parameters(shape, seed)).to(device.place)
        self._arrays = {name: array.requires_grad_() for name, array in split_tensor(shape, self._parameters).items()}
        self._optimizer = Adam([Group(list(self._arrays.values()), settings.learning_rate, settings.weight_decay)])

    # Rows

    def _is_fit(self, rows: Float32Array) -> np.ndarray:
        return is_fit(rows)

    def _choose(self, rows: Float32Array) -> Float32Array:
        """Rows that are lit, of a unit direction, and within what float64 can multiply."""
        with np.errstate(over="ignore", invalid="ignore"):
            length = np.square(rows[:, ROW_WI : ROW_WI + 3], dtype=np.float64).sum(axis=1)
            is_lit = np.abs(length - 1.0) < 0.01
            for value in (self._target(rows), rows[:, ROW_PDF], rows[:, ROW_RADIANCE]):
                is_lit &= (value > _LEAST) & (value < _MOST)
        return rows[is_lit]

    def _prepare(self, rows: Float32Array, bounds: Float32Array) -> None:
        if self.scale == 0.0:
            weights = self._target(rows) / rows[:, ROW_PDF]
            # Without the brightest thousandth.
            self.scale = float(np.minimum(weights, np.quantile(weights, 0.999)).mean())
        # Only for what vertices and directions are encoded with, which has no parameters.
        self._field: FlowField = view_flow_field(
            self.shape, bounds, np.zeros(self.shape.parameter_count, np.float32), is_ready=False
        )

        self._place = self._tensor(self._field.center), self._tensor(self._field.inverse_extent)

    def _target(self, rows: Float32Array) -> np.ndarray:
        """What the flow's density is to be proportional to: float64 (N,)."""
        target = rows[:, ROW_RADIANCE].astype(np.float64)
        if self.settings.target == "PRODUCT":
            target = target * rows[:, ROW_REFLECTANCE]
        return target

    # Flow

    def _log_density(self, condition: torch.Tensor, square: torch.Tensor) -> torch.Tensor:
        """Logarithm of the density over the unit square: (N,)."""
        arrays = self._arrays
        a, b = square[:, 0], square[:, 1]
        log_density = torch.zeros_like(a)
        inner_count = self.shape.hidden_layers - 1
        for layer in range(self.shape.layer_count):
            moves_b = layer % 2 == 0
            passed = one_blob(a if moves_b else b, self.shape.blob_bins)
            value = torch.addmm(
                condition @ arrays["condition_weights"][layer], passed, arrays["passed_weights"][layer]
            ).clamp(0.0, ACTIVATION_LIMIT)
            for inner in range(inner_count):
                weights = arrays["hidden_weights"][layer * inner_count + inner]
                value = (value @ weights).clamp(0.0, ACTIVATION_LIMIT)
            outputs = torch.addmm(arrays["output_bias"][layer], value, arrays["output_weights"][layer])
            moved, log_factor = move(outputs, b if moves_b else a)
            a, b = (a, moved) if moves_b else (moved, b)
            log_density = log_density + log_factor
        return log_density

    def _encode(self, rows: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        """Features of the vertices, and the directions' points of the square."""
        if isinstance(rows, torch.Tensor):
            return self._encode_torch(rows)
        condition = np.empty((rows.shape[0], self.shape.condition_width), np.float32)
        square = np.empty((rows.shape[0], 2), np.float32)
        encode_flow_rows(self._field, rows, condition, square)
        return torch.from_numpy(condition), torch.from_numpy(square)

    def _encode_torch(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """`_encode` on the device."""
        place = contract_torch(rows[:, ROW_POSITION : ROW_POSITION + 3], *self._place)
        wo, normal = rows[:, ROW_WO : ROW_WO + 3], rows[:, ROW_NORMAL : ROW_NORMAL + 3]
        coordinates = torch.cat((place, 0.5 + 0.5 * wo, 0.5 + 0.5 * normal, rows[:, [ROW_ROUGHNESS]]), dim=1)
        columns = zip(coordinates.clamp(0.0, 1.0).unbind(1), self.shape.condition_bins, strict=True)
        condition = torch.cat([one_blob(column, bin_count) for column, bin_count in columns], dim=1)
        return condition, direction_to_square_torch(rows[:, ROW_WI : ROW_WI + 3])

    def density(self, rows: Float32Array) -> Float32Array:
        """Density at the directions and vertices of rows, float32 (N,) [sr^-1]: what `eval_flow` must give too."""
        with torch.no_grad():
            log_density = self._log_density(*self._encode(self._there(rows))).cpu().numpy()
        return np.exp(log_density) * np.float32(0.25 / np.pi)

    # Training

    def _weigh(self, rows: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        """Target / pdf in units of `scale`, capped, and the logarithm of pdf * 4 pi: (N,) each."""
        if isinstance(rows, torch.Tensor):
            return self._weigh_torch(rows)
        pdf = rows[:, ROW_PDF].astype(np.float64)
        weights = np.minimum(self._target(rows) / (pdf * self.scale), self.settings.weight_limit)
        # A weight that float32 calls zero has no logarithm.
        weights = np.maximum(weights, _LEAST)
        logs = np.log(pdf * (4.0 * np.pi))
        return (
            torch.from_numpy(weights.astype(np.float32)),
            torch.from_numpy(logs.astype(np.float32)),
        )

    def _weigh_torch(self, rows: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """`_weigh` on the device."""
        pdf, target = rows[:, ROW_PDF].double(), rows[:, ROW_RADIANCE].double()
        if self.settings.target == "PRODUCT":
            target = target * rows[:, ROW_REFLECTANCE]
        weights = (target / (pdf * self.scale)).clamp(max=self.settings.weight_limit).clamp(min=_LEAST)
        return weights.float(), torch.log(pdf * (4.0 * math.pi)).float()

    def _divergence(self, log_density: torch.Tensor, weights: torch.Tensor, log_pdf: torch.Tensor) -> torch.Tensor:
        """Divergence from the target to the flow, but for a constant: a mean over records.

        Chi-square is the second moment E[(target / pdf) (target / density)], of which this is the logarithm: its
        gradient has the size of the other divergence's, whatever the scene.
        """
        if self.settings.divergence == "KL":
            return -(weights * log_density).mean()
        return torch.logsumexp(2.0 * torch.log(weights) + log_pdf - log_density, dim=0) - math.log(len(weights))

    def _loss(self, rows: Rows) -> tuple[torch.Tensor, Sequence[torch.Tensor]]:
        return self._divergence(self._log_density(*self._encode(rows)), *self._weigh(rows)), ()

    def _bound_gradients(self, features: Sequence[torch.Tensor]) -> bool:
        """The gradient is cut to a length; a batch without a finite one changes nothing."""
        norm = torch.nn.utils.clip_grad_norm_(list(self._arrays.values()), self.settings.gradient_limit)
        return math.isfinite(norm.item())

    def _answer(self, rows: Rows) -> torch.Tensor:
        return self._log_density(*self._encode(rows))

    def _judge(self, rows: Rows, answer: torch.Tensor, previous: torch.Tensor) -> tuple[float, float]:
        """Divergence, and its fall: in nats by the mean record for Kullback-Leibler, relative for chi-square."""
        weights, log_pdf = self._weigh(rows)
        weights = weights / weights.mean()
        error = self._divergence(answer, weights, log_pdf).item()
        return error, self._divergence(previous, weights, log_pdf).item() - error

    def _snapshot_parameters(self) -> Float32Array:
        return self._parameters.detach().cpu().numpy()
