# SPDX-License-Identifier: GPL-3.0-or-later
"""Training mixture networks: cross entropy of the target by samples, Adam, snapshots of averaged parameters.

Each row weighs what its target is over the density it was drawn with; the mixture's log density is averaged by these
weights, which minimises the Kullback-Leibler divergence from target to mixture, whatever the target's scale. Features,
the gradient of the grids and their optimiser are the engine's kernels, torch does the perceptron and the lobes. On a
device torch does all.

What keeps noise from throwing the network off: rows that are not finite never come in; a row weighs at most a share of
its batch; densities have a floor; a gradient that is not finite counts as none, and the whole is cut to a length.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding", Eqs. 8 and 9.
Huang et al. 2024, "Online Neural Path Guiding with Normalized Anisotropic Spherical Gaussians", Eqs. 17 and 18.
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", Eq. 12.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import torch

from engine.array_types import Float32Array
from engine.guiding.neural.networks.mixture.features import (
    MixtureEncoding,
    backpropagate_grids,
    backpropagate_hashes,
    backpropagate_planes,
    encode_features,
    make_mixture_encoding,
)
from engine.guiding.neural.networks.mixture.shape import (
    TABLES,
    MixtureSettings,
    MixtureShape,
    initial_parameters,
)
from engine.guiding.neural.worker.adam import TABLE_EPSILON, Adam, Group
from engine.guiding.neural.worker.devices import PROCESSOR, Device, Rows
from engine.guiding.neural.worker.lobes import decode, log_pdf
from engine.guiding.neural.worker.row_weights import row_weights, targets
from engine.guiding.neural.worker.tables import LearnedTable
from engine.guiding.neural.worker.torch_features import TorchFeatures
from engine.guiding.neural.worker.torch_weights import row_weights_torch
from engine.guiding.neural.worker.training import Training, split_tensor
from engine.guiding.records.training_rows import (
    ROW_BSDF_PDF,
    ROW_NORMAL,
    ROW_POSITION,
    ROW_ROUGHNESS,
    ROW_U,
    ROW_WI,
    ROW_WO,
    is_fit,
)

#: Rows are kept that lie no further beyond the range of u than this many times its length: a stratum on either side has
#: much to say about this one (docs/decisions/time-and-wavelengths.md).
_U_MARGIN = 1.0
#: Density of a BSDF that cannot have proposed a direction [sr^-1].
_NO_DENSITY = 1e-20


def _layers(arrays: Mapping[str, torch.Tensor]) -> list[torch.Tensor]:
    """`MixtureShape.matrices` of tensors."""
    hidden = arrays["hidden_weights"]
    return [arrays["input_weights"], *(hidden[index] for index in range(len(hidden))), arrays["output_weights"]]


def _finite(gradient: torch.Tensor) -> torch.Tensor:
    """A gradient whose numbers that are not finite count as none."""
    return gradient.nan_to_num(nan=0.0, posinf=0.0, neginf=0.0)


class MixtureTraining(Training):
    """A mixture network in training; parameters as in `Training`."""

    shape: MixtureShape
    settings: MixtureSettings
    _encoding: MixtureEncoding
    _u_column = ROW_U

    def __init__(
        self, shape: MixtureShape, settings: MixtureSettings, seed: int, bounds: Float32Array | None = None,
        thread_count: int = 1, device: Device = PROCESSOR,
    ) -> None:
        super().__init__(shape, settings, seed, bounds, thread_count, device)
        # Mixtures have no unit.
        self.scale = 1.0
        #: Sums of the weights of the rows up to each one, by age; None: to be found again.
        self._cumulative: np.ndarray | None = None

        # Two vectors of the same layout: the parameters, and their running average, which snapshots carry.
        self._parameters = torch.from_numpy(initial_parameters(shape, seed)).to(device.place)
        self._average = self._parameters.clone()
        arrays, averages = split_tensor(shape, self._parameters), split_tensor(shape, self._average)
        self._matrices = [matrix.requires_grad_() for matrix in _layers(arrays)]
        self._average_matrices = _layers(averages)
        self._learned = {name: arrays[name] for name in TABLES if name in arrays}
        groups = [Group(self._matrices, settings.learning_rate, settings.weight_decay)]
        if device.is_apart:
            learned = [table.requires_grad_() for table in self._learned.values()]
            groups.append(Group(learned, settings.table_learning_rate, skips=True))
        else:
            self._tables = self._processor_tables(averages)
        self._optimizer = Adam(groups, TABLE_EPSILON)

    def _processor_tables(self, averages: Mapping[str, torch.Tensor]) -> list[LearnedTable]:
        """What the engine's kernels step."""
        shape, settings = self.shape, self.settings
        tables = {
            "table": (backpropagate_grids, shape.level_count, 0),
            "planes": (backpropagate_planes, shape.plane_levels, shape.position_width),
            "hashes": (backpropagate_hashes, shape.hash_levels, shape.position_width + shape.plane_width),
        }
        return [
            LearnedTable(
                self._learned[name].numpy(), backpropagate, level_count=level_count,
                learning_rate=settings.table_learning_rate, first_column=first_column, average=averages[name].numpy(),
                averaging=settings.averaging,
            )
            for name, (backpropagate, level_count, first_column) in tables.items()
            if name in self._learned
        ]

    # Rows

    def _is_fit(self, rows: Float32Array) -> np.ndarray:
        return is_fit(rows)

    def _choose(self, rows: Float32Array) -> Float32Array:
        lit = rows[targets(self.shape, rows) > 0.0]
        # Not for rows without light: there must always be something to train on.
        if lit.shape[0] and self.settings.follows_u:
            self._forget(rows)
        return lit

    def _forget(self, rows: Float32Array) -> None:
        """Keep only rows that lie near the range of u of the new ones, within its piece."""
        u = self._within_piece(rows[:, ROW_U])
        least, most = float(u.min()), float(u.max())
        margin = _U_MARGIN * (most - least)
        for window in (self.window, self.validation):
            held = self._within_piece(window.take(np.arange(window.count))[:, ROW_U])
            window.keep((held >= least - margin) & (held <= most + margin))

    def _within_piece(self, u: Float32Array) -> Float32Array:
        """Where numbers in [0, 1] are in their pieces, in [0, 1]."""
        return np.mod(u * self.settings.u_pieces, 1.0) if self.settings.u_pieces > 1 else u

    def _prepare(self, rows: Float32Array, bounds: Float32Array) -> None:
        self._cumulative = None
        if self._device.is_apart:
            self._features = TorchFeatures(self.shape, bounds, self._learned, self._device.place)
        else:
            tables = {name: table.numpy() for name, table in self._learned.items()}
            self._encoding = make_mixture_encoding(self.shape, bounds, tables)

    # Network

    def _encode(self, rows: Rows) -> torch.Tensor:
        """Features (N, feature_width)."""
        if isinstance(rows, torch.Tensor):
            return self._features(rows)
        position, normal, wo = (
            np.ascontiguousarray(rows[:, column : column + 3]) for column in (ROW_POSITION, ROW_NORMAL, ROW_WO)
        )
        roughness, u = (np.ascontiguousarray(rows[:, column]) for column in (ROW_ROUGHNESS, ROW_U))
        features = np.empty((rows.shape[0], self.shape.feature_width), np.float32)
        self._over_rows(
            lambda start, stop: encode_features(
                self._encoding, position, normal, wo, roughness, u, start, stop, features[start:stop]
            ),
            rows.shape[0],
        )
        return torch.from_numpy(features)

    def _perceptron(self, features: torch.Tensor) -> torch.Tensor:
        """Raw outputs (N, output_width)."""
        value = features
        for matrix in self._matrices[:-1]:
            value = torch.relu(value @ matrix)
        return value @ self._matrices[-1]

    def predict(self, rows: Float32Array) -> Float32Array:
        """Raw outputs at the points of rows, float32 (N, output_width): what `inference` gives for these parameters."""
        with torch.no_grad():
            return self._perceptron(self._encode(self._there(rows))).cpu().numpy()

    def _log_densities(self, raw: torch.Tensor, rows: Rows) -> tuple[torch.Tensor, torch.Tensor]:
        """Log density of the mixture at each row's direction (N,), and what the loss takes the mean of (N,)."""
        shape, settings = self.shape, self.settings
        wi = self._tensor(rows[:, ROW_WI : ROW_WI + 3])
        lobe_columns = shape.output_width - int(shape.has_selection)
        log_mixture = log_pdf(decode(shape.lobe_model.lower(), raw[:, :lobe_columns]), wi)
        floor = torch.full_like(log_mixture, math.log(settings.epsilon)) if settings.epsilon > 0.0 else None
        learned = log_mixture if floor is None else torch.logaddexp(log_mixture, floor)
        if not shape.has_selection:
            return log_mixture, learned
        # Eq. 18: mixture and BSDF together, at the learned share.
        bsdf = self._tensor(rows[:, ROW_BSDF_PDF]).clamp(min=_NO_DENSITY).log()
        logit = raw[:, shape.selection_column]
        log_share = torch.nn.functional.logsigmoid
        both = torch.logaddexp(log_share(logit) + learned, log_share(-logit) + bsdf)
        return log_mixture, settings.selection_share * both + (1.0 - settings.selection_share) * learned

    # Training

    def draw(self) -> Rows:
        """A random batch of rows: by weight, if the settings ask for that."""
        if not self.settings.is_drawn_by_weight:
            return super().draw()
        count, batch_size = self.window.count, self.settings.batch_size
        if self._cumulative is None:
            held = self.window.take(np.arange(count))
            self._cumulative = np.cumsum(row_weights(self.shape, self.settings, held), dtype=np.float64)
        # One from each of as many equal parts of all weight: no batch is without its share of the rare and bright.
        places = (np.arange(batch_size) + self._random.uniform(size=batch_size)) * (self._cumulative[-1] / batch_size)
        picks = np.minimum(np.searchsorted(self._cumulative, places, side="right"), count - 1)
        return self._take(self.window, picks)

    def batch_weights(self, rows: Rows) -> torch.Tensor:
        """What each row of a batch weighs: (batch,). Rows drawn by weight weigh the same."""
        if self._cumulative is None:
            return self._weigh(rows)
        return torch.full((len(rows),), float(self._cumulative[-1] > 0.0), device=self._device.place)

    def _weigh(self, rows: Rows) -> torch.Tensor:
        """`row_weights`, on the device: (N,)."""
        if isinstance(rows, torch.Tensor):
            return row_weights_torch(self.shape, self.settings, rows)
        return torch.from_numpy(row_weights(self.shape, self.settings, rows))

    def _loss(self, rows: Rows) -> tuple[torch.Tensor, Sequence[torch.Tensor]]:
        features = self._encode(rows)
        if features.requires_grad:
            # Of a device's tables; those of the processor get theirs from the features (`_bound_gradients`).
            features.register_hook(_finite)
        else:
            features.requires_grad_(bool(self._tables))
        _, learned = self._log_densities(self._perceptron(features), rows)
        loss = -(self.batch_weights(rows) * learned).mean()
        return loss, [features] * len(self._tables)

    def _bound_gradients(self, features: Sequence[torch.Tensor]) -> bool:
        """Numbers that are not finite count as none, and the perceptron's gradient is cut to a length."""
        for tensor in (*self._matrices, *features[:1]):
            if tensor.grad is not None:
                tensor.grad = _finite(tensor.grad)
        torch.nn.utils.clip_grad_norm_(self._matrices, self.settings.gradient_limit)
        return True

    def step(self) -> None:
        """One step of training on a random batch, and of the average."""
        super().step()
        share = 1.0 - self.settings.averaging
        with torch.no_grad():
            if self._device.is_apart:
                self._average.lerp_(self._parameters, share)
                return
            # Tables have theirs when they are stepped.
            for average, matrix in zip(self._average_matrices, self._matrices, strict=True):
                average += share * (matrix - average)

    def _answer(self, rows: Rows) -> torch.Tensor:
        """Log density of the mixture, and what the loss takes the mean of: (2, N)."""
        return torch.stack(self._log_densities(self._perceptron(self._encode(rows)), rows))

    def _judge(self, rows: Rows, answer: torch.Tensor, previous: torch.Tensor) -> tuple[float, float]:
        """Cross entropy of target and mixture, in nats, which may be negative; and by how much rows became likelier."""
        weights = self._weigh(rows)
        return -(weights * answer[0]).mean().item(), (weights * (answer[1] - previous[1])).mean().item()

    def _snapshot_parameters(self) -> Float32Array:
        """The average of the network's last states."""
        for table in self._tables:
            table.catch_up(self.step_count)
        return self._average.cpu().numpy()
