# SPDX-License-Identifier: GPL-3.0-or-later
"""Training mixture networks: cross entropy of the target by samples, Adam, snapshots of averaged parameters.

Each row weighs what its target is over the density it was drawn with; the mixture's log density is averaged by these
weights, which minimises the Kullback-Leibler divergence from target to mixture, whatever the target's scale. Features,
the gradient of the grids and their optimiser are the engine's kernels, torch does the perceptron and the lobes.

What keeps noise from throwing the network off: rows that are not finite never come in; a row weighs at most a share of
its batch; densities have a floor; a gradient that is not finite counts as none, and the whole is cut to a length.

References
----------
Dong et al. 2023, "Neural Parametric Mixtures for Path Guiding", Eqs. 8 and 9.
Huang et al. 2024, "Online Neural Path Guiding with Normalized Anisotropic Spherical Gaussians", Eqs. 17 and 18.
Dong et al. 2025, "Efficient Neural Path Guiding with 4D Modeling", Eq. 12.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import torch

from engine.guiding.mixture.features import encode_features, make_mixture_encoding
from engine.guiding.mixture.shape import TABLES, MixtureSettings, MixtureShape, initial_parameters
from engine.guiding.network import Snapshot, robust_bounds
from engine.guiding.rows import (
    ROW_BSDF_PDF,
    ROW_GUIDE_PDF,
    ROW_NORMAL,
    ROW_PDF,
    ROW_POSITION,
    ROW_RADIANCE,
    ROW_REFLECTANCE,
    ROW_ROUGHNESS,
    ROW_U,
    ROW_WI,
    ROW_WIDTH,
    ROW_WO,
    is_fit,
)
from engine.guiding.worker.lobes import decode, log_pdf
from engine.guiding.worker.samples import VALIDATION_STRIDE, SampleWindow
from engine.guiding.worker.tables import ADAM_EPSILON, BETAS, LearnedTable
from engine.scene.arrays import Float32Array

_VALIDATION_ROWS = 1 << 14
#: Rows of a batch that must be able to bear all of its weight.
_LEAST_BEARERS = 8
#: Share of the weight that a row has at most where few rows have nearly all of it.
_MOST_SHARE = 1.0 / 128.0
#: Rows are kept that lie no further beyond the range of u than this many times its length: a stratum on either side has
#: much to say about this one (docs/benchmarks.md).
_U_MARGIN = 1.0
#: Density of a BSDF that cannot have proposed a direction [sr^-1].
_NO_DENSITY = 1e-20


def targets(shape: MixtureShape, rows: Float32Array) -> np.ndarray:
    """What the mixture is to be proportional to, at the direction of each row.

    Parameters
    ----------
    rows : float32 (N, ROW_WIDTH)

    Returns
    -------
    float64 (N,), not negative
    """
    values = rows[:, ROW_RADIANCE].astype(np.float64)
    if shape.target == "PRODUCT":
        return values * rows[:, ROW_REFLECTANCE]
    if shape.target == "COSINE":
        normal = rows[:, ROW_NORMAL : ROW_NORMAL + 3].astype(np.float64)
        return values * np.abs((normal * rows[:, ROW_WI : ROW_WI + 3]).sum(axis=1))
    return values


def row_weights(shape: MixtureShape, settings: MixtureSettings, rows: Float32Array) -> Float32Array:
    """Weights of a batch's rows: target over density, none above a share of them all, one on average.

    Parameters
    ----------
    rows : float32 (N, ROW_WIDTH)

    Returns
    -------
    float32 (N,), finite and not negative; all zero if no row has light
    """
    with np.errstate(all="ignore"):
        weights = targets(shape, rows) / (rows[:, ROW_PDF] + settings.epsilon)
        if settings.mis_compensation:
            # Eq. 12. Rows from before there was a guide, where the BSDF had to do alone, count in full.
            guide = (1.0 - settings.bsdf_share) * rows[:, ROW_GUIDE_PDF].astype(np.float64)
            both = guide + settings.bsdf_share * rows[:, ROW_BSDF_PDF]
            weights = np.where(guide > 0.0, weights * guide / both, weights)
    weights[~np.isfinite(weights)] = 0.0
    weights = limit_outliers(weights, settings.outlier_share, settings.kept_weight)
    mean = weights.mean()
    return (weights / mean if mean > 0.0 else weights).astype(np.float32)


def limit_shares(weights: np.ndarray, share: float) -> np.ndarray:
    """Cut weights so that none is above `share` of the sum of all, cut ones included.

    Parameters
    ----------
    weights : float64 (N,), finite and not negative
    share : float
        Raised where N is small, so that a few rows can always bear all the weight.

    Returns
    -------
    float64 (N,)
    """
    share = min(1.0, max(share, _LEAST_BEARERS / max(weights.size, 1)))
    descending = np.sort(weights)[::-1]
    # With the k heaviest at the limit c: c = share * (k c + the rest).
    rest = np.concatenate((np.cumsum(descending[::-1])[::-1], (0.0,)))
    for k in range(weights.size):
        free = 1.0 - share * k
        if free <= 0.0:
            break
        limit = share * rest[k] / free
        if 0.0 < limit >= descending[k]:
            # The k heaviest are cut, and no other.
            return np.minimum(weights, limit)
    # So few rows have light that no limit exists: let them weigh the same.
    return (weights > 0.0).astype(np.float64)


def limit_outliers(weights: np.ndarray, share: float, kept: float) -> np.ndarray:
    """`limit_shares`, but less strict where it would cut away more than 1 - `kept` of all weight.

    A few rows may be noise. Where most of the light is in few rows it is a caustic, seldom found because it is not
    guided to yet: to cut those is to learn never to look there. Still, none weighs more than a share of _MOST_SHARE.

    Parameters
    ----------
    weights : float64 (N,), finite and not negative
    share, kept : float in [0, 1]

    Returns
    -------
    float64 (N,)
    """
    strict = limit_shares(weights, share)
    total = weights.sum()
    if strict.sum() >= kept * total:
        return strict
    descending = np.sort(weights)[::-1]
    # With the k heaviest at the limit c: k c + the rest = kept * total; the first c that the next one is below.
    rest = total - np.cumsum(descending)
    limits = (kept * total - rest) / np.arange(1, weights.size + 1)
    fits = limits >= np.append(descending[1:], 0.0)
    return limit_shares(np.minimum(weights, limits[np.argmax(fits)]), max(share, _MOST_SHARE))


class MixtureTraining:
    """The network in training, on the CPU.

    Parameters
    ----------
    shape : MixtureShape
    settings : MixtureSettings
    seed : int
    bounds : float32 (2, 3) [m] or None
        What the position is resolved in; None: found from the first rows.
    thread_count : int
        The result is the same bits for one only.
    """

    #: Unit of what the network gives: mixtures have none.
    scale = 1.0

    def __init__(
        self,
        shape: MixtureShape,
        settings: MixtureSettings,
        seed: int,
        bounds: Float32Array | None = None,
        thread_count: int = 1,
    ) -> None:
        torch.set_num_threads(thread_count)
        self.shape = shape
        self.settings = settings
        self.step_count = 0
        self.rows_received = 0
        self.loss = math.nan
        self.bounds = bounds
        self._version = 0
        self._random = np.random.Generator(np.random.Philox(seed))
        self._pool = ThreadPoolExecutor(thread_count) if thread_count > 1 else None
        self._thread_count = thread_count
        self._window = SampleWindow(settings.buffer_rows, ROW_WIDTH, settings.window_samples)
        self._validation = SampleWindow(_VALIDATION_ROWS, ROW_WIDTH, settings.window_samples)
        self._reference: torch.Tensor | None = None
        #: Sums of the weights of the rows up to each one, by age; None: to be found again.
        self._cumulative: np.ndarray | None = None

        # Two vectors of the same layout: the parameters, and their running average, which snapshots carry.
        self._parameters = initial_parameters(shape, seed)
        self._average = self._parameters.copy()
        self._arrays, averages = shape.split(self._parameters), shape.split(self._average)
        self._matrices = [torch.from_numpy(matrix).requires_grad_() for matrix in shape.matrices(self._parameters)]
        self._average_matrices = shape.matrices(self._average)
        self._optimizer = torch.optim.Adam(
            self._matrices, settings.learning_rate, BETAS, ADAM_EPSILON, settings.weight_decay
        )
        columns = {
            "table": (0, shape.level_count),
            "planes": (shape.position_width, shape.plane_levels),
            "hashes": (shape.position_width + shape.plane_width, shape.hash_levels),
        }
        self._tables = [
            LearnedTable(
                name, self._arrays[name], averages[name], first_column=columns[name][0], level_count=columns[name][1],
                learning_rate=settings.table_learning_rate, averaging=settings.averaging,
            )
            for name in TABLES
            if name in self._arrays
        ]

    # Rows

    @property
    def can_train(self) -> bool:
        """There are rows with light."""
        return self._window.count > 0

    @property
    def row_count(self) -> int:
        """Rows that training draws from."""
        return self._window.count

    def add(self, rows: Float32Array, samples: float) -> None:
        """Take rows of `samples` samples a pixel: float32 (N, ROW_WIDTH).

        Rows not fit to learn from are left out, and so are those whose target is zero: they have no gradient.
        """
        rows = rows[is_fit(rows)]
        if rows.shape[0] == 0:
            return
        if self.bounds is None:
            self.bounds = robust_bounds(rows[:, ROW_POSITION : ROW_POSITION + 3])
        self._cumulative = None
        u = rows[:, ROW_U]
        first = self.rows_received
        # Black ones count: how often the others are looked at goes by how much of the scene has been seen.
        self.rows_received += rows.shape[0]
        rows = rows[targets(self.shape, rows) > 0.0]
        if rows.shape[0] == 0:
            return
        if self.settings.follows_u:
            # Not for rows without light: there must always be something to train on.
            self._forget(u)
        is_validation = (first + np.arange(rows.shape[0])) % VALIDATION_STRIDE == 0
        # A first row that only validates would be nothing to train on.
        is_validation &= rows.shape[0] > 1
        self._validation.add(rows[is_validation], samples)
        self._window.add(rows[~is_validation], samples)
        self._reference = None
        self._encoding = make_mixture_encoding(self.shape, self.bounds, self._arrays)

    def _forget(self, u: Float32Array) -> None:
        """Keep only rows that lie near the range of u, within its piece."""
        u = self._within_piece(u)
        least, most = float(u.min()), float(u.max())
        margin = _U_MARGIN * (most - least)
        for window in (self._window, self._validation):
            held = self._within_piece(window.take(np.arange(window.count))[:, ROW_U])
            window.keep((held >= least - margin) & (held <= most + margin))

    def _within_piece(self, u: Float32Array) -> Float32Array:
        """Where numbers in [0, 1] are in their pieces, in [0, 1]."""
        return np.mod(u * self.settings.u_pieces, 1.0) if self.settings.u_pieces > 1 else u

    # Network

    def _over_rows(self, work: Callable[[int, int], None], count: int) -> None:
        """Call work(start, stop) over ranges of `count`, on all threads."""
        if self._pool is None:
            work(0, count)
            return
        edges = [count * k // self._thread_count for k in range(self._thread_count + 1)]
        list(self._pool.map(work, edges[:-1], edges[1:]))

    def _encode(self, rows: Float32Array) -> tuple[torch.Tensor, Float32Array, Float32Array]:
        """Features (N, feature_width), and the positions (N, 3) and times (N,) they are of."""
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
        return torch.from_numpy(features), position, u

    def _perceptron(self, features: torch.Tensor) -> torch.Tensor:
        """Raw outputs (N, output_width)."""
        value = features
        for matrix in self._matrices[:-1]:
            value = torch.relu(value @ matrix)
        return value @ self._matrices[-1]

    def predict(self, rows: Float32Array) -> Float32Array:
        """Raw outputs at the points of rows, float32 (N, output_width): what `inference` gives for these parameters."""
        with torch.no_grad():
            return self._perceptron(self._encode(rows)[0]).numpy()

    def _log_densities(self, raw: torch.Tensor, rows: Float32Array) -> tuple[torch.Tensor, torch.Tensor]:
        """Log density of the mixture at each row's direction (N,), and what the loss takes the mean of (N,)."""
        shape, settings = self.shape, self.settings
        wi = torch.from_numpy(np.ascontiguousarray(rows[:, ROW_WI : ROW_WI + 3]))
        lobe_columns = shape.output_width - int(shape.has_selection)
        log_mixture = log_pdf(decode(shape.lobe_model.lower(), raw[:, :lobe_columns]), wi)
        floor = torch.full_like(log_mixture, math.log(settings.epsilon)) if settings.epsilon > 0.0 else None
        learned = log_mixture if floor is None else torch.logaddexp(log_mixture, floor)
        if not shape.has_selection:
            return log_mixture, learned
        # Eq. 18: mixture and BSDF together, at the learned share.
        bsdf = torch.from_numpy(np.ascontiguousarray(rows[:, ROW_BSDF_PDF])).clamp(min=_NO_DENSITY).log()
        logit = raw[:, shape.selection_column]
        log_share = torch.nn.functional.logsigmoid
        both = torch.logaddexp(log_share(logit) + learned, log_share(-logit) + bsdf)
        return log_mixture, settings.selection_share * both + (1.0 - settings.selection_share) * learned

    def _draw(self) -> tuple[Float32Array, Float32Array]:
        """A random batch: rows (batch, ROW_WIDTH), and what each weighs (batch,)."""
        count, batch_size = self._window.count, self.settings.batch_size
        if not self.settings.is_drawn_by_weight:
            rows = self._window.take(self._random.integers(0, count, batch_size))
            return rows, row_weights(self.shape, self.settings, rows)
        if self._cumulative is None:
            held = self._window.take(np.arange(count))
            self._cumulative = np.cumsum(row_weights(self.shape, self.settings, held), dtype=np.float64)
        # One from each of as many equal parts of all weight: no batch is without its share of the rare and bright.
        places = (np.arange(batch_size) + self._random.uniform(size=batch_size)) * (self._cumulative[-1] / batch_size)
        picks = np.minimum(np.searchsorted(self._cumulative, places, side="right"), count - 1)
        return self._window.take(picks), np.full(batch_size, self._cumulative[-1] > 0.0, np.float32)

    def step(self) -> None:
        """One step of training on a random batch."""
        settings = self.settings
        rows, row_weight = self._draw()
        features, position, u = self._encode(rows)
        features.requires_grad_(bool(self._tables))
        weights = torch.from_numpy(row_weight)
        _, learned = self._log_densities(self._perceptron(features), rows)
        loss = -(weights * learned).mean()
        self._optimizer.zero_grad()
        loss.backward()
        gradients = [matrix.grad for matrix in self._matrices if matrix.grad is not None]
        if features.grad is not None:
            gradients.append(features.grad)
        for gradient in gradients:
            gradient.nan_to_num_(nan=0.0, posinf=0.0, neginf=0.0)
        torch.nn.utils.clip_grad_norm_(self._matrices, settings.gradient_limit)
        self._optimizer.step()
        self.step_count += 1
        with torch.no_grad():
            for average, matrix in zip(self._average_matrices, self._matrices, strict=True):
                average += np.float32(1.0 - settings.averaging) * (matrix.numpy() - average)
        if features.grad is not None:
            feature_gradient = features.grad.numpy()
            for table in self._tables:
                table.step(self._encoding, position, u, feature_gradient, self.step_count, self._over_rows)

    # Progress

    def improvement(self) -> float:
        """How much likelier held-out rows became since the last call: the gain of their mean log density.

        After new rows it is infinite: there is nothing to compare with. `loss` becomes the cross entropy of the
        target and the mixture, in nats, which may be negative.
        """
        rows = self._validation.take(np.arange(self._validation.count))
        if rows.shape[0] == 0:
            return math.inf
        with torch.no_grad():
            log_mixture, learned = self._log_densities(self._perceptron(self._encode(rows)[0]), rows)
            weights = torch.from_numpy(row_weights(self.shape, self.settings, rows))
            self.loss = -(weights * log_mixture).mean().item()
            previous, self._reference = self._reference, learned
            if previous is None:
                return math.inf
            return (weights * (learned - previous)).mean().item()

    def snapshot(self) -> Snapshot:
        """The average of the network's last states; its parameters are a view that the next step changes."""
        if self.bounds is None or not self.can_train:
            raise ValueError("no snapshot before the first rows with light")
        self._version += 1
        for table in self._tables:
            table.catch_up(self.step_count)
        return Snapshot(self._version, self.step_count, self.loss, self.scale, self.bounds, self._average)
