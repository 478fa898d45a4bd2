# SPDX-License-Identifier: GPL-3.0-or-later
"""What all trainings share: the rows they draw from, the step, the test on held-out rows, the snapshots."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from engine.array_types import Float32Array, Int64Array
from engine.guiding.neural.networks.encoding import Encoding
from engine.guiding.neural.networks.mixture.features import MixtureEncoding
from engine.guiding.neural.networks.radiance import Snapshot, TrainableShape, TrainingSettings, robust_bounds
from engine.guiding.neural.worker.adam import Adam
from engine.guiding.neural.worker.devices import PROCESSOR, Device, DeviceRows, Rows
from engine.guiding.neural.worker.reservoir import RowReservoir
from engine.guiding.neural.worker.tables import LearnedTable
from engine.guiding.records.training_rows import ROW_POSITION

#: Every so manyth row is kept for validation.
_VALIDATION_STRIDE = 32
_VALIDATION_ROWS = 1 << 14


def split_tensor(shape: TrainableShape, parameters: torch.Tensor) -> dict[str, torch.Tensor]:
    """Views of the arrays of `shape.layout` into one vector of `parameter_count` floats, on any device."""
    parts = parameters.split([math.prod(sizes) for sizes in shape.layout.values()])
    return {name: part.view(sizes) for (name, sizes), part in zip(shape.layout.items(), parts, strict=True)}


class Training(ABC):
    """A network in training. A kind of network adds its loss, its parameters and what it reads of a row.

    A subclass makes `_optimizer`, and `_tables` where it has tables of features.

    Parameters
    ----------
    shape, settings
        As the kind of network has.
    seed : int
    bounds : float32 (2, 3) [m] or None
        What positions are resolved in; None: found from the first rows.
    thread_count : int
        Threads to use on the CPU. The result is the same bits for one only.
    device : Device
        What trains: the processor with the engine's kernels, or a device on which torch does all, on rows, tables and
        an optimiser that lie there.

    Attributes
    ----------
    window, validation : RowReservoir
        The rows that training draws from, and those held out.
    """

    #: Column of u in a row.
    _u_column = -1
    _encoding: Encoding | MixtureEncoding
    _optimizer: Adam

    def __init__(
        self, shape: TrainableShape, settings: TrainingSettings, seed: int, bounds: Float32Array | None,
        thread_count: int, device: Device = PROCESSOR,
    ) -> None:
        torch.set_num_threads(thread_count)
        self.shape = shape
        self.settings = settings
        self.step_count = 0
        self.rows_received = 0
        self.loss = math.nan
        #: What the network's unit stands for; 0 before it is known.
        self.scale = 0.0
        self.bounds = bounds
        self._version = 0
        self._random = np.random.Generator(np.random.Philox(seed))
        self._pool = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self._thread_count = thread_count
        self.window = RowReservoir(settings.buffer_rows, shape.row_width, self._random)
        self.validation = RowReservoir(_VALIDATION_ROWS, shape.row_width, self._random)
        self._device = device
        self._rows_apart = {
            id(reservoir): DeviceRows(reservoir, device.place) for reservoir in (self.window, self.validation)
        }
        self._reference: torch.Tensor | None = None
        self._tables: list[LearnedTable] = []

    # What a kind of network adds

    def _is_fit(self, rows: Float32Array) -> np.ndarray:
        """Which rows can be learned from: bool (N,). The others are ignored."""
        return np.ones(rows.shape[0], bool)

    def _choose(self, rows: Float32Array) -> Float32Array:
        """Those fit rows that have a gradient. The others only count."""
        return rows

    @abstractmethod
    def _prepare(self, rows: Float32Array, bounds: Float32Array) -> None:
        """Make the encoding, and find the scale, now that there are bounds and these rows."""

    @property
    def looks_worth(self) -> float:
        """Looks at rows that training is worth so far: more would learn their noise."""
        return self.settings.epochs * self.rows_received

    def draw(self) -> Rows:
        """A random batch of rows."""
        return self._take(self.window, self._random.integers(0, self.window.count, self.settings.batch_size))

    def _take(self, reservoir: RowReservoir, picks: Int64Array) -> Rows:
        """Rows of `window` or `validation` by number, where they are trained on."""
        return self._rows_apart[id(reservoir)].take(picks) if self._device.is_apart else reservoir.take(picks)

    def _held_out(self) -> Rows:
        """All rows held out."""
        return self._take(self.validation, np.arange(self.validation.count))

    def _there(self, rows: Float32Array) -> Rows:
        """Rows, where they are trained on."""
        return self._tensor(rows) if self._device.is_apart else rows

    def _tensor(self, values: Float32Array | torch.Tensor) -> torch.Tensor:
        """Numbers of rows as a tensor on the device."""
        if isinstance(values, torch.Tensor):
            return values
        return torch.from_numpy(np.ascontiguousarray(values)).to(self._device.place)

    @abstractmethod
    def _loss(self, rows: Rows) -> tuple[torch.Tensor, Sequence[torch.Tensor]]:
        """Loss () of a batch; and for each of `_tables` the features it was found from, whose gradient is wanted."""

    def _bound_gradients(self, features: Sequence[torch.Tensor]) -> bool:
        """Make gradients fit for a step; whether there may be one."""
        return True

    @abstractmethod
    def _answer(self, rows: Rows) -> torch.Tensor:
        """What the network says of held-out rows."""

    @abstractmethod
    def _judge(self, rows: Rows, answer: torch.Tensor, previous: torch.Tensor) -> tuple[float, float]:
        """Loss of an answer, and how much better it is than the previous one."""

    @abstractmethod
    def _snapshot_parameters(self) -> Float32Array:
        """The parameter vector that snapshots carry."""

    # Rows

    @property
    def can_train(self) -> bool:
        """There are rows, and not all of them are black."""
        return self.window.count > 0 and self.scale > 0.0

    @property
    def row_count(self) -> int:
        """Rows that training draws from."""
        return self.window.count

    def add(self, rows: Float32Array) -> None:
        """Take rows to learn from.

        Rows not fit to learn from are left out, and so are those without a gradient. The latter count among
        `rows_received`: how often the others are looked at goes by how much of the scene has been seen.

        Parameters
        ----------
        rows : float32 (N, row_width)
        """
        rows = rows[self._is_fit(rows)]
        if rows.shape[0] == 0:
            return
        if self.bounds is None:
            self.bounds = robust_bounds(rows[:, ROW_POSITION : ROW_POSITION + 3])
        first = self.rows_received
        self.rows_received += rows.shape[0]
        lit = self._choose(rows)
        if lit.shape[0] == 0:
            return
        is_validation = (first + np.arange(lit.shape[0])) % _VALIDATION_STRIDE == 0
        # A first row that only validates would be nothing to train on.
        is_validation &= lit.shape[0] > 1
        self.validation.add(lit[is_validation])
        self.window.add(lit[~is_validation])
        self._reference = None
        self._prepare(lit, self.bounds)

    # Training

    def _over_rows(self, work: Callable[[int, int], None], count: int) -> None:
        """Call work(start, stop) over ranges of `count`, on all threads."""
        if self._pool is None:
            work(0, count)
            return
        edges = [count * k // self._thread_count for k in range(self._thread_count + 1)]
        list(self._pool.map(work, edges[:-1], edges[1:]))

    def step(self) -> None:
        """One step of training on a random batch."""
        rows = self.draw()
        loss, features = self._loss(rows)
        self._optimizer.forget_gradients()
        loss.backward()
        if self._bound_gradients(features):
            self._optimizer.step()
        self.step_count += 1
        if not self._tables:
            return
        # Tables that the engine's kernels step are those of the processor.
        assert isinstance(rows, np.ndarray)
        positions = np.ascontiguousarray(rows[:, ROW_POSITION : ROW_POSITION + 3])
        u = np.ascontiguousarray(rows[:, self._u_column])
        for table, feature in zip(self._tables, features, strict=True):
            if feature.grad is not None:
                table.step(self._encoding, positions, u, feature.grad.numpy(), self.step_count, self._over_rows)

    def improvement(self) -> float:
        """How much better the network's answers on held-out rows became since the last call; sets `loss`.

        After new rows it is infinite: there is nothing to compare with.
        """
        if self.validation.count == 0 or not self.can_train:
            return math.inf
        rows = self._held_out()
        with torch.no_grad():
            answer = self._answer(rows)
            previous, self._reference = self._reference, answer
            self.loss, gain = self._judge(rows, answer, answer if previous is None else previous)
        return math.inf if previous is None else gain

    def snapshot(self) -> Snapshot:
        """The network as it is; its parameters are a view that the next step changes.

        Raises
        ------
        ValueError
            Before the first rows with light.
        """
        if self.bounds is None or not self.can_train:
            raise ValueError("no snapshot before the first rows with light")
        self._version += 1
        return Snapshot(
            self._version, self.step_count, self.loss, self.scale, self.bounds, self._snapshot_parameters()
        )
