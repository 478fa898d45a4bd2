# SPDX-License-Identifier: GPL-3.0-or-later
"""Training the radiance network: divergence of the mean radiance from what it predicts, Adam.

On the CPU the encodings of grid and planes, their gradients and optimiser are the engine's kernels and torch does the
perceptron; on a device torch does everything. Both act on one parameter vector with the layout of `NetworkShape`.

References
----------
Rath et al. 2025, section 5: network and encodings. Its relative squared error, cut so that bright records cannot throw
the exponential off, loses light that fewer than one record in eleven has (docs/decisions/radiance-network.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import torch

from engine.array_types import Float32Array
from engine.guiding.neural.networks.encoding import (
    Encoding,
    backpropagate_positions,
    backpropagate_u,
    encode_directions,
    encode_positions,
    encode_u,
    make_encoding,
)
from engine.guiding.neural.networks.radiance import (
    LOG_RADIANCE_LIMIT,
    NetworkShape,
    Snapshot,
    TrainingSettings,
    initial_parameters,
)
from engine.guiding.neural.worker.adam import TABLE_EPSILON, Adam, Group
from engine.guiding.neural.worker.devices import PROCESSOR, Device, Rows
from engine.guiding.neural.worker.overfitting import BestParameters
from engine.guiding.neural.worker.row_weights import limit_shares
from engine.guiding.neural.worker.tables import LearnedTable
from engine.guiding.neural.worker.torch_encoding import blobs, encode_positions_torch, encode_u_torch
from engine.guiding.neural.worker.training import Training, split_tensor

#: Share of a batch that is drawn evenly; the others are drawn as often as they have light.
_EVEN_SHARE = 0.5
#: No row is believed to have more of all light held than this share, where there are twice as many lit rows at least.
_MOST_SHARE = 1.0 / 128.0
#: Times that a record with light is looked at on average, by how much light there is in how few records: more often the
#: network learns by heart where they are, and is dark between them.
_BRIGHT_LOOKS = 64.0
#: A network learns rows by heart within a few dozen steps if it does so at all. So the rows held out are looked at
#: after these steps, and then whenever there were so many times as many.
_FIRST_LOOK, _LOOK_GROWTH = 4, 1.25
#: Length that the perceptron's gradient is cut to.
_GRADIENT_LIMIT = 1.0


class _Features(NamedTuple):
    """A batch as the perceptron sees it: float32 (N, features) each; `u` is None where the network does not see it."""

    position: torch.Tensor
    direction: torch.Tensor
    u: torch.Tensor | None


def _believed(brightness: np.ndarray) -> np.ndarray:
    """Brightness of rows without what single ones have beyond belief: float64 (N,)."""
    lit_count = np.count_nonzero(brightness)
    return limit_shares(brightness, _MOST_SHARE) if lit_count * _MOST_SHARE >= 2.0 else brightness


class RadianceTraining(Training):
    """The radiance network in training; parameters as in `Training`.

    Parameters
    ----------
    device : Device
        As of `Training`.
    """

    shape: NetworkShape
    _encoding: Encoding

    def __init__(
        self, shape: NetworkShape, settings: TrainingSettings, seed: int, bounds: Float32Array | None = None,
        thread_count: int = 1, device: Device = PROCESSOR,
    ) -> None:
        super().__init__(shape, settings, seed, bounds, thread_count, device)
        self._parameters = torch.from_numpy(initial_parameters(shape, seed)).to(device.place)
        arrays = split_tensor(shape, self._parameters)
        tables = {name: arrays.pop(name) for name in ("table", "planes") if name in arrays}
        self._grid, self._planes = tables["table"], tables.get("planes")
        self._arrays = {name: array.requires_grad_() for name, array in arrays.items()}
        groups = [Group(list(self._arrays.values()), settings.learning_rate, settings.weight_decay)]
        if not device.is_apart:
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
            learned = [table.requires_grad_() for table in tables.values()]
            groups.append(Group(learned, settings.table_learning_rate, skips=True))
        self._optimizer = Adam(groups, TABLE_EPSILON)
        self._best = BestParameters()
        #: Whether rows held out had become worse, and none have come since.
        self._is_worn = False
        self._next_look = _FIRST_LOOK

    def go_on_from(self, snapshot: Snapshot) -> None:
        """Begin with the parameters of another training; its bounds and unit stay."""
        with torch.no_grad():
            self._parameters.copy_(torch.from_numpy(snapshot.parameters))
        self.bounds, self.scale, self._version = snapshot.bounds, snapshot.scale, snapshot.version

    def _prepare(self, rows: Float32Array, bounds: Float32Array) -> None:
        self._share: np.ndarray | None = None
        self._best.forget()
        self._is_worn = False
        if self.scale == 0.0:
            self.scale = float(_believed(self._brightness(rows)).mean())
        # On the CPU these are views of the parameters in training.
        self._encoding = make_encoding(self.shape, bounds, self._parameters.detach().cpu().numpy())
        if self._device.is_apart:
            self._place = self._tensor(self._encoding.center), self._tensor(self._encoding.inverse_extent)

    def _radiance(self, rows: Float32Array) -> Float32Array:
        """Radiance of rows: float32 (N, channels), a view."""
        return rows[:, 6 : 6 + self.shape.channel_count]

    def _brightness(self, rows: Float32Array) -> np.ndarray:
        """Mean of a row's radiance over the channels that are known: float64 (N,)."""
        return np.nanmean(self._radiance(rows), axis=1, dtype=np.float64)

    def _encode(self, rows: Rows) -> _Features:
        """Features of rows."""
        if isinstance(rows, torch.Tensor):
            return self._encode_torch(rows)
        positions = np.ascontiguousarray(rows[:, :3])
        directions = np.ascontiguousarray(rows[:, 3:6])
        encoded_directions = np.empty((rows.shape[0], self.shape.direction_width), np.float32)
        bins = self.shape.direction_bins
        self._over_rows(
            lambda start, stop: encode_directions(directions, bins, start, stop, encoded_directions), rows.shape[0]
        )
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

    def _encode_torch(self, rows: torch.Tensor) -> _Features:
        """`_encode` on the device, differentiable in the tables."""
        shape, positions = self.shape, rows[:, :3]
        encoded_u = None
        if shape.u_width:
            planes = self._planes if self._planes is not None else self._grid[:0]
            level = torch.from_numpy(self._encoding.plane_level)
            encoded_u = encode_u_torch(level, *self._place, planes, shape.u_frequencies, positions, rows[:, -1])
        level = torch.from_numpy(self._encoding.level)
        encoded = encode_positions_torch(level, *self._place, self._grid, positions)
        return _Features(encoded, blobs(0.5 + 0.5 * rows[:, 3:6], shape.direction_bins), encoded_u)

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
            return (self._perceptron(self._encode(self._there(rows))) * self.scale).cpu().numpy()

    # Rows

    def _weigh(self) -> None:
        """Find how often each row held is drawn, and how much of its light is believed."""
        brightness = self._brightness(self.window.take(np.arange(self.window.count)))
        believed = _believed(brightness)
        total = believed.sum()
        self._bright_rows = total * total / np.square(believed).sum() if total > 0.0 else 0.0
        even = 1.0 / len(brightness)
        self._share = _EVEN_SHARE * even + (1.0 - _EVEN_SHARE) * believed / max(total, 1e-300)
        self._cumulative = np.cumsum(self._share)
        self._kept = np.divide(believed, brightness, out=np.ones_like(believed), where=brightness > 0.0)

    @property
    def looks_worth(self) -> float:
        """Looks at rows that training is worth: few where few rows have all the light, none where training is worn."""
        if not self.can_train or self._is_worn:
            return 0.0
        if self._share is None:
            self._weigh()
        seen = self.rows_received / max(self.window.count, 1)
        bright = _BRIGHT_LOOKS * self._bright_rows * seen / (1.0 - _EVEN_SHARE)
        return min(super().looks_worth, bright)

    def draw(self) -> Rows:
        """A batch of rows: half of it evenly, half as often as rows have light. Sets what each of them counts."""
        if self._share is None:
            self._weigh()
        assert self._share is not None
        count, batch_size = self.window.count, self.settings.batch_size
        # One from each of as many equal parts: no batch is without its share of the rare and bright.
        places = (np.arange(batch_size) + self._random.uniform(size=batch_size)) * (self._cumulative[-1] / batch_size)
        picks = np.minimum(np.searchsorted(self._cumulative, places, side="right"), count - 1)
        self._counts = (1.0 / (count * self._share[picks])).astype(np.float32)
        rows, kept = self._take(self.window, picks), self._kept[picks, None]
        if isinstance(rows, torch.Tensor):
            rows[:, 6 : 6 + self.shape.channel_count] *= self._tensor(kept.astype(np.float32))
        else:
            self._radiance(rows)[:] *= kept
        return rows

    def _believable(self, rows: Float32Array) -> Float32Array:
        """Rows with as much light as is believed: a copy."""
        brightness = self._brightness(rows)
        kept = np.divide(_believed(brightness), brightness, out=np.ones_like(brightness), where=brightness > 0.0)
        rows = rows.copy()
        self._radiance(rows)[:] *= kept[:, None]
        return rows

    def _held_out(self) -> Rows:
        return self._there(self._believable(self.validation.take(np.arange(self.validation.count))))

    # Loss

    def _divergences(self, prediction: torch.Tensor, rows: Rows) -> torch.Tensor:
        """Generalised Kullback-Leibler divergence of each row's radiance and prediction, but for a constant: (N,).

        It is the mean over the channels that are known. Where it is least on average the prediction is the mean of the
        radiance, however rare light is: its gradient by the exponential's argument is the difference of the two.
        """
        radiance = self._tensor(rows[:, 6 : 6 + self.shape.channel_count])
        targets = radiance * float(np.float32(1.0 / self.scale))
        if not self.shape.by_quarter:
            return (prediction - targets * prediction.log()).mean(1)
        is_known = ~torch.isnan(targets)
        # What is not known has no gradient, not one times zero.
        divergences = torch.where(is_known, prediction - torch.nan_to_num(targets) * prediction.log(), 0.0)
        return divergences.sum(1) / is_known.sum(1)

    def _loss(self, rows: Rows) -> tuple[torch.Tensor, Sequence[torch.Tensor]]:
        features = self._encode(rows)
        # There is no table of planes where u is seen by frequencies alone, and none at all on a device.
        learned = [
            tensor.requires_grad_()
            for tensor, _ in zip((features.position, features.u), self._tables, strict=False)
            if tensor is not None
        ]
        counts = self._tensor(self._counts)
        return (counts * self._divergences(self._perceptron(features), rows)).mean(), learned

    def _bound_gradients(self, features: Sequence[torch.Tensor]) -> bool:
        """The perceptron's gradient is cut to a length; a batch without a finite one changes nothing."""
        norm = torch.nn.utils.clip_grad_norm_(list(self._arrays.values()), _GRADIENT_LIMIT)
        return bool(torch.isfinite(norm))

    def _answer(self, rows: Rows) -> torch.Tensor:
        return self._perceptron(self._encode(rows))

    def _judge(self, rows: Rows, answer: torch.Tensor, previous: torch.Tensor) -> tuple[float, float]:
        """Divergence of held-out rows from the answer, and how far it fell."""
        error = self._divergences(answer, rows).mean().item()
        return error, self._divergences(previous, rows).mean().item() - error

    # Overfitting

    def step(self) -> None:
        """One step of training on a random batch; now and then a look at held-out rows, and back if they are worse."""
        if not self._best.is_known:
            self._look_at_held_out()
        super().step()
        if self.step_count >= self._next_look:
            self._look_at_held_out()
            self._next_look = max(self.step_count + _FIRST_LOOK, int(self.step_count * _LOOK_GROWTH))

    def _look_at_held_out(self) -> None:
        """Keep the parameters, or go back to better ones and rest."""
        if not self.validation.count:
            return
        rows = self._held_out()
        with torch.no_grad():
            losses = self._divergences(self._answer(rows), rows)
        self._is_worn = self._best.see(losses, self._parameters)

    def _snapshot_parameters(self) -> Float32Array:
        return self._parameters.detach().cpu().numpy()
