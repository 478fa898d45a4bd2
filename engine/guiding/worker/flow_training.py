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

import numpy as np
import torch

from engine.guiding.flow.field import view_flow_field
from engine.guiding.flow.query import encode_flow_rows
from engine.guiding.flow.shape import (
    ACTIVATION_LIMIT,
    LOGIT_LIMIT,
    MIN_WIDTH,
    UNIFORM_SHARE,
    FlowSettings,
    FlowShape,
    initial_flow_parameters,
)
from engine.guiding.network import Snapshot, robust_bounds
from engine.guiding.rows import ROW_PDF, ROW_POSITION, ROW_RADIANCE, ROW_REFLECTANCE, ROW_WI
from engine.guiding.worker.samples import VALIDATION_STRIDE, SampleWindow
from engine.scene.arrays import Float32Array

_BETAS = (0.9, 0.99)
_VALIDATION_ROWS = 1 << 14
#: Columns that training reads.
_KEPT = ROW_PDF + 1
#: Positions further out than this [m] are as far as bounds can tell.
_FARTHEST = 1e15
#: Densities and targets outside are not kept: their products stay within float64, their logarithms within reason.
_LEAST, _MOST = 1e-30, 1e30


def one_blob(coordinate: torch.Tensor, bin_count: int) -> torch.Tensor:
    """`blob` of encoding.py for coordinates in [0, 1], all bins: (N, bin_count); differentiable."""
    position = coordinate[:, None] * (bin_count - 2)
    distance = (position - torch.arange(bin_count, device=coordinate.device) + 0.5).abs()
    return torch.where(distance < 0.5, 0.75 - distance.square(), 0.5 * (1.5 - distance).clamp(min=0.0).square())


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


class FlowTraining:
    """The flow in training.

    Parameters
    ----------
    shape : FlowShape
    settings : FlowSettings
    seed : int
    bounds : float32 (2, 3) [m] or None
        What positions are resolved in; None: found from the first records.
    thread_count : int
        Threads of torch on the CPU. The result is the same bits for one only.
    device : str
        'cpu' or a device of torch.
    """

    def __init__(
        self,
        shape: FlowShape,
        settings: FlowSettings,
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
        self._window = SampleWindow(settings.buffer_rows, _KEPT, settings.window_samples)
        self._validation = SampleWindow(_VALIDATION_ROWS, _KEPT, settings.window_samples)
        self._reference: torch.Tensor | None = None
        self._parameters = torch.from_numpy(initial_flow_parameters(shape, seed)).to(self._device)
        self._arrays: dict[str, torch.Tensor] = {}
        start = 0
        for name, sizes in shape.layout.items():
            stop = start + math.prod(sizes)
            self._arrays[name] = self._parameters[start:stop].view(sizes).requires_grad_()
            start = stop
        self._optimizer = torch.optim.Adam(
            list(self._arrays.values()),
            lr=settings.learning_rate,
            betas=_BETAS,
            weight_decay=settings.weight_decay,
        )

    # Records

    @property
    def can_train(self) -> bool:
        """There are records that show where light comes from."""
        return self._window.count > 0 and self.scale > 0.0

    @property
    def row_count(self) -> int:
        """Records that training draws from."""
        return self._window.count

    def add(self, rows: Float32Array, samples: float) -> None:
        """Take records of `samples` samples a pixel: float32 (N, ROW_WIDTH). Those that teach nothing are left out."""
        is_validation = (self.rows_received + np.arange(rows.shape[0])) % VALIDATION_STRIDE == 0
        self.rows_received += rows.shape[0]
        is_kept = self._is_usable(rows)
        if not is_kept.any():
            return
        rows, is_validation = rows[is_kept, :_KEPT], is_validation[is_kept]
        position = slice(ROW_POSITION, ROW_POSITION + 3)
        rows[:, position] = np.clip(rows[:, position], -_FARTHEST, _FARTHEST)
        self._validation.add(rows[is_validation], samples)
        self._window.add(rows[~is_validation], samples)
        self._reference = None
        if self.bounds is None:
            self.bounds = robust_bounds(rows[:, position])
        if self.scale == 0.0:
            weights = self._target(rows) / rows[:, ROW_PDF]
            # Without the brightest thousandth.
            self.scale = float(np.minimum(weights, np.quantile(weights, 0.999)).mean())
        self._field = view_flow_field(
            self.shape, self.bounds, np.zeros(self.shape.parameter_count, np.float32), is_ready=False
        )

    def _target(self, rows: Float32Array) -> np.ndarray:
        """What the flow's density is to be proportional to: float64 (N,)."""
        target = rows[:, ROW_RADIANCE].astype(np.float64)
        if self.settings.target == "PRODUCT":
            target = target * rows[:, ROW_REFLECTANCE]
        return target

    def _is_usable(self, rows: Float32Array) -> np.ndarray:
        """Which records are finite, of a unit direction, and lit: bool (N,)."""
        rows = rows[:, :_KEPT]
        is_usable = np.isfinite(rows).all(axis=1)
        with np.errstate(over="ignore", invalid="ignore"):
            target = self._target(rows)
            length = np.square(rows[:, ROW_WI : ROW_WI + 3], dtype=np.float64).sum(axis=1)
            for value in (target, rows[:, ROW_PDF], rows[:, ROW_RADIANCE]):
                is_usable &= (value > _LEAST) & (value < _MOST)
            return is_usable & (np.abs(length - 1.0) < 0.01)

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

    def _encode(self, rows: Float32Array) -> tuple[torch.Tensor, torch.Tensor]:
        """Features of the vertices, and the directions' points of the square."""
        condition = np.empty((rows.shape[0], self.shape.condition_width), np.float32)
        square = np.empty((rows.shape[0], 2), np.float32)
        encode_flow_rows(self._field, rows, condition, square)
        return torch.from_numpy(condition).to(self._device), torch.from_numpy(square).to(self._device)

    def density(self, rows: Float32Array) -> Float32Array:
        """Density at the directions and vertices of rows, float32 (N,) [sr^-1]: what `eval_flow` must give too."""
        with torch.no_grad():
            log_density = self._log_density(*self._encode(rows)).cpu().numpy()
        return np.exp(log_density) * np.float32(0.25 / np.pi)

    # Training

    def _weigh(self, rows: Float32Array) -> tuple[torch.Tensor, torch.Tensor]:
        """Target / pdf in units of `scale`, capped, and the logarithm of pdf * 4 pi: (N,) each."""
        pdf = rows[:, ROW_PDF].astype(np.float64)
        weights = np.minimum(self._target(rows) / (pdf * self.scale), self.settings.weight_limit)
        # A weight that float32 calls zero has no logarithm.
        weights = np.maximum(weights, _LEAST)
        logs = np.log(pdf * (4.0 * np.pi))
        return (
            torch.from_numpy(weights.astype(np.float32)).to(self._device),
            torch.from_numpy(logs.astype(np.float32)).to(self._device),
        )

    def _divergence(self, log_density: torch.Tensor, weights: torch.Tensor, log_pdf: torch.Tensor) -> torch.Tensor:
        """Divergence from the target to the flow, but for a constant: a mean over records.

        Chi-square is the second moment E[(target / pdf) (target / density)], of which this is the logarithm: its
        gradient has the size of the other divergence's, whatever the scene.
        """
        if self.settings.divergence == "KL":
            return -(weights * log_density).mean()
        return torch.logsumexp(2.0 * torch.log(weights) + log_pdf - log_density, dim=0) - math.log(len(weights))

    def step(self) -> None:
        """One step of training on a random batch; a batch without a finite gradient changes nothing."""
        rows = self._window.take(self._random.integers(0, self._window.count, self.settings.batch_size))
        loss = self._divergence(self._log_density(*self._encode(rows)), *self._weigh(rows))
        self._optimizer.zero_grad()
        loss.backward()
        norm = torch.nn.utils.clip_grad_norm_(list(self._arrays.values()), self.settings.gradient_limit)
        if math.isfinite(norm.item()):
            self._optimizer.step()
        self.step_count += 1

    def improvement(self) -> float:
        """How far the divergence on held-out records fell since the last call.

        A fall of Kullback-Leibler in nats by the mean record, a relative one of chi-square. After new records it is
        infinite: there is nothing to compare with.
        """
        rows = self._validation.take(np.arange(self._validation.count))
        if rows.shape[0] == 0 or not self.can_train:
            return math.inf
        with torch.no_grad():
            log_density = self._log_density(*self._encode(rows))
            weights, log_pdf = self._weigh(rows)
            weights = weights / weights.mean()
            previous, self._reference = self._reference, log_density
            error = self._divergence(log_density, weights, log_pdf).item()
            self.loss = error
            if previous is None:
                return math.inf
            return self._divergence(previous, weights, log_pdf).item() - error

    def snapshot(self) -> Snapshot:
        """The flow as it is; its parameters are a view that the next step changes."""
        if self.bounds is None or self.scale <= 0.0:
            raise ValueError("no snapshot before the first records with light")
        self._version += 1
        parameters = self._parameters.detach().cpu().numpy()
        return Snapshot(self._version, self.step_count, self.loss, self.scale, self.bounds, parameters)
