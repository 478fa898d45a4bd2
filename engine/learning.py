# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the iterations of a guided render: what paths recorded becomes the next iteration's guidance.

The lengths of iterations and the weights with which they enter the image are functions of their index alone, never of
what was sampled, so the mean stays unbiased. What is learned concerns distributions and candidate counts only.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import numpy as np

from engine.film import Film, FilmTile
from engine.guidance import Guidance
from engine.guiding import trial
from engine.guiding.light_share import LightShareModel
from engine.guiding.network import NETWORK_SHAPES
from engine.guiding.network_query import NetworkField, make_network_field
from engine.guiding.selection import SelectionModel
from engine.guiding.source_model import DETERMINISTIC_STEPS, SourceModel, TreeSource, make_source_model
from engine.guiding.table import TableModel
from engine.guiding.trainer import NetworkTrainer, TrainerState
from engine.guiding.trial import GuidingTrial
from engine.guiding.vertices import VertexRecords, allocate_vertex_records, as_records, compensate
from engine.guiding.vmm.leaves import find_leaves
from engine.guiding.vmm.model import VmmModel
from engine.ris.orca import (
    FLOOR,
    CandidateCosts,
    VarianceDeltas,
    image_variance,
    make_allocation,
    mean_by_region,
    pixel_weights,
)
from engine.scene.description import Notice
from engine.settings import NETWORK_SOURCES, SOURCES, RenderSettings
from engine.work import Unit, UnitCosts

#: Samples a pixel of the longest iterations.
LONGEST_ITERATION = 16
#: Records that an iteration aims at: what fitting and training can look at in the time they have.
RECORDS_PER_ITERATION = 1 << 18
#: Records of a recorded path, until it is known.
_EXPECTED_RECORDS_PER_PATH = 4.0
#: Costs in rays where no clock may be asked (docs/experiments.md): of guiding a vertex, and a factor for learning.
_GUIDED_COST = 1.0
_LEARNING_COST = 1.15
_NEURAL_CANDIDATE_COST = 0.4
#: Share of the guided vertices from which on resampling is measured: of a few candidates at a time a network's cost is
#: that of the calls.
_LEAST_MEASURED = 0.2
#: Training a network takes time from every path. It begins once in so many iterations running at least this share of
#: the vertices was worth several candidates, and is given up once in as many it was less.
_NETWORK_PATIENCE = 2
_LEAST_RESAMPLED = 0.1
#: Samples a pixel after which an iteration counts fully.
_FULL_WEIGHT_SAMPLES = 8


def iteration_lengths(samples: int) -> list[int]:
    """Samples a pixel of each iteration: one first, doubling to LONGEST_ITERATION (Rath et al. 2025, section 5.1)."""
    lengths: list[int] = []
    left, length = samples, 1
    while left > 0:
        lengths.append(min(length, left))
        left -= lengths[-1]
        length = min(2 * length, LONGEST_ITERATION)
    return lengths


def iteration_weight(first_sample: int, sample_weighting: str) -> float:
    """Weight of each sample of the iteration that begins with `first_sample`.

    Early iterations knew little: their samples count less, in proportion to what had been seen when they were taken.
    """
    if sample_weighting == "UNIFORM":
        return 1.0
    return min((first_sample + 1) / _FULL_WEIGHT_SAMPLES, 1.0)


@dataclass
class GuidingReport:
    """What guiding did; times in seconds of all threads together."""

    method: str = "OFF"
    field_seconds: float = 0.0
    training_seconds: float = 0.0
    region_count: int = 0
    lobe_count: float = 0.0
    record_count: int = 0
    network_loss: float = float("nan")
    network_step: int = 0
    snapshot_count: int = 0
    has_trained: bool = False
    #: The sample from which on the network was given up, 0: never.
    network_stopped_at: int = 0
    candidates_per_vertex: float = 0.0
    worker: str = ""
    #: What directions are drawn from, if not the mixture field.
    source: str = ""
    source_seconds: float = 0.0
    #: Efficiency over unguided rendering when last compared; the sample from which on guiding was given up, 0: never.
    efficiency: float = float("nan")
    stopped_at: int = 0

    lines: list[str] = field(default_factory=list)

    def describe(self, stage_seconds: dict[str, float]) -> None:
        """Write `lines` for people, given the time of the tracing threads by stage."""
        tracing = sum(stage_seconds.values())
        training = self.training_seconds + self.source_seconds
        everything = max(tracing + self.field_seconds + training, 1e-9)
        inference = stage_seconds.get("predict_radiance", 0.0)
        self.lines = [
            f"guiding {self.method}: {(tracing - inference) / everything:.0%} of the time tracing, "
            f"{self.field_seconds / everything:.0%} fitting, {inference / everything:.0%} predicting, "
            f"{training / everything:.0%} training; {self.candidates_per_vertex:.2f} candidates a vertex, "
            f"{self.region_count} regions of {self.lobe_count:.1f} lobes, {self.record_count} records"
        ]
        if self.stopped_at:
            self.lines.append(
                f"guiding did not pay here ({self.efficiency:.2f} of the efficiency without): samples from "
                f"{self.stopped_at + 1} on are not guided"
            )
        if self.source:
            self.lines.append(self.source)
        if self.worker:
            self.lines.append(
                f"radiance network: {self.snapshot_count} snapshots, {self.network_step} steps, "
                f"loss {self.network_loss:.3g}, worker {self.worker}"
            )
        if self.method == "NEURAL_RIS" and not self.has_trained:
            self.lines.append(
                "radiance network: not trained, hardly a vertex was worth several candidates"
            )
        if self.network_stopped_at:
            self.lines.append(
                "radiance network: hardly a vertex was worth asking it; from sample "
                f"{self.network_stopped_at + 1} on directions come from the mixture alone"
            )


@dataclass
class IterationCosts:
    """What the iteration's threads measured."""

    stage_seconds: Counter[str]
    ray_count: int
    path_count: int
    guided_vertices: int
    several_vertices: int
    several_candidates: int


def _joined(units: Sequence[VertexRecords]) -> tuple[VertexRecords, int]:
    """Records of all units one after the other."""
    columns = [np.ascontiguousarray(np.concatenate(column)) for column in zip(*units, strict=True)]
    return VertexRecords(*columns), len(columns[3])


class Learner:
    """Owns the fields of one render.

    Parameters
    ----------
    settings : RenderSettings
        With a guiding method.
    thread_count : int
    paths_per_sample : int
        Pixels of the image.
    """

    def __init__(self, settings: RenderSettings, thread_count: int, paths_per_sample: int) -> None:
        self.settings = settings
        self.notices: list[Notice] = []
        self._thread_count = thread_count
        self._paths_per_sample = paths_per_sample
        self._executor = ThreadPoolExecutor(thread_count, thread_name_prefix="learn")
        self._vmm: VmmModel | None = None
        self._table: TableModel | None = None
        self._selection = SelectionModel(settings.guiding_probability)
        self._light_share = LightShareModel()
        self._max_distance = 0.0
        self._records_per_path = _EXPECTED_RECORDS_PER_PATH
        self._deltas = VarianceDeltas()
        self._costs = CandidateCosts()
        if settings.guiding_method == "NEURAL_RIS":
            self._costs = CandidateCosts(per_candidate=_NEURAL_CANDIDATE_COST)
        self._network: NetworkField | None = None
        #: Iterations running in which a network would have been worth its time, or not.
        self._worth_count = self._worthless_count = 0
        self._iteration = 0
        #: Parts of this iteration: first sample, samples, whether guided (`engine.guiding.trial`).
        self.parts = [(0, 1, True)]
        self._trial: GuidingTrial | None = None
        self._has_won = self._is_over = False
        #: Where samples are given, the images of statistical methods do not depend on clocks.
        has_network = settings.guiding_method == "NEURAL_RIS" or settings.source in NETWORK_SOURCES
        depends_on_clock = has_network or settings.time_limit > 0.0
        self._uses_clock = depends_on_clock and not settings.deterministic
        self._learning_seconds = 0.0
        self._trainer: NetworkTrainer | None = None
        self.report = GuidingReport(method=settings.guiding_method)
        self._source: SourceModel | None = make_source_model(settings)
        if settings.guiding_method == "NEURAL_RIS" and not self._weighs_network():
            self._start_network()
        if settings.radiance_cache and settings.guiding_method not in ("TABLE_RIS", "NEURAL_RIS"):
            # The mixture knows no colour.
            problem = "works with TABLE_RIS and NEURAL_RIS only"
            self.notices.append(Notice("Guiding / radiance cache", problem, "paths are not cut short"))

    def _weighs_network(self) -> bool:
        """Whether the network may be left out: not where a number of candidates or the cache was asked for."""
        return self.settings.candidate_allocation == "ORCA" and not self.settings.radiance_cache

    def _probes_only(self) -> bool:
        """Whether allocation is only tried, for want of a network that resampling would be for."""
        return self.settings.guiding_method == "NEURAL_RIS" and self._weighs_network() and self._network is None

    def _start_network(self) -> None:
        self.report.has_trained = True
        self._shape = NETWORK_SHAPES[self.settings.network_size]
        self._trainer = NetworkTrainer(
            self._shape, seed=self.settings.seed, training_share=self.settings.training_share,
            deterministic=self.settings.deterministic,
        )
        self._trainer.start()

    def _give_up(self, reason: str) -> None:
        """The network is lost: say so once, and let the mixture predict."""
        self.notices.append(
            Notice("Guiding / radiance network", reason, "the statistical field weighs the candidates")
        )

    def first(self) -> Guidance:
        """Guidance of the first iteration: none, but record."""
        return Guidance(self.settings, self._threshold(1))

    def rehearse(self) -> Guidance:
        """Load (or compile) the kernels of learning by learning from nothing in particular.

        Returns
        -------
        Guidance
            Fit to call every guided stage with, on no lanes.
        """
        rng = np.random.default_rng(0)
        records = allocate_vertex_records(256)
        direction = rng.normal(size=(256, 3))
        records.position[:] = rng.random((256, 3))
        records.direction[:] = direction / np.linalg.norm(direction, axis=1)[:, None]
        records.normal[:] = (0.0, 0.0, 1.0)
        for column in (records.radiance, records.pdf, records.distance, records.roughness):
            column[:] = 1.0
        vmm = VmmModel(np.array([[0.0, 0.0, 0.0], [1.0, 1.0, 1.0]]))
        vmm.update(as_records(records), 256)
        leaf = np.zeros(256, np.int32)
        find_leaves(vmm.field, records.position, leaf)
        SelectionModel(0.5).update(vmm, records, leaf, variance=1.0, ray_count=1.0)
        if isinstance(self._source, TreeSource):
            TreeSource(self.settings).learn(records, 256, 1.0, 1.0, self._executor, 1)
        table = None
        if self.settings.guiding_method == "TABLE_RIS":
            model = TableModel()
            model.update(vmm)
            table = model.field
        allocation = make_allocation(np.zeros(1, np.float32), ray_count=1.0, variance=1.0, costs=self._costs)
        ones = np.ones(1, np.float32)
        return Guidance(
            self.settings, 0, vmm.field, ones, ones, ones, 1, allocation,
            np.ones(self._paths_per_sample, np.float32), table,
        )

    def _threshold(self, samples: int) -> int:
        """Record so many of the next iteration's paths that about RECORDS_PER_ITERATION records come of them."""
        expected = self._records_per_path * self._paths_per_sample * samples
        return int(min(RECORDS_PER_ITERATION / max(expected, 1.0), 1.0) * 2**32)

    def learn(
        self, units: Sequence[VertexRecords], recorded_share: float, film: Film, costs: IterationCosts,
        next_range: tuple[int, int],
    ) -> Guidance:
        """Learn from an iteration, and say how to go on.

        Parameters
        ----------
        units : VertexRecords of each tile, in an order that does not depend on threads
        recorded_share : float, of the guided paths that were recorded
        film : Film, the image so far
        costs : IterationCosts
        next_range : (int, int)
            First sample and samples a pixel of the next iteration.
        """
        started = time.perf_counter()
        self._iteration += 1
        # In a trial a part of the samples only.
        samples = self.parts[0][1]
        guided_share = samples / sum(count for _, count, _ in self.parts)
        sums = film.sums
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        mean = sums.radiance / weight
        weights = pixel_weights(
            mean.reshape(film.height, film.width, -1), is_relative=self.settings.orca_error == "RELATIVE"
        )
        if self._trial is not None:
            tracing = guided_share * sum(costs.stage_seconds.values())
            self._judge(self._trial, weights, next_range[0], tracing)
        if self._is_over:
            self._trial = None
            self.parts = [(*next_range, True)]
            return Guidance(self.settings, 0)
        knows_something = self._vmm is not None if self._source is None else self._source.field is not None
        is_tried = self.settings.guiding_trial and knows_something and not self._has_won
        self.parts = trial.parts(self._iteration, *next_range, is_tried=is_tried)
        self._trial = GuidingTrial(self._paths_per_sample) if len(self.parts) > 1 else None
        next_samples = self.parts[0][1]
        records, row_count = _joined(units)
        self.report.record_count += row_count
        if row_count:
            self._records_per_path = max(
                row_count / max(recorded_share * guided_share * costs.path_count, 1.0), 0.01
            )
            fitted = records
            if self.settings.mis_compensation:
                fitted = compensate(records, row_count, self.settings.guiding_probability)
            self._fit(fitted, row_count)
        if self._vmm is None:
            return Guidance(self.settings, self._threshold(next_samples))
        if row_count:
            self._deltas.add(records.position[:row_count], records.benefit[:row_count])
        self._weigh_network(costs, recorded_share, next_range[0])
        self._train(records, row_count, samples)
        self._learn_source(records, row_count, samples, recorded_share)

        method = self.settings.guiding_method
        ray_count = costs.ray_count / max(costs.path_count, 1)
        variance = image_variance(mean, sums.square / weight, weights)
        if row_count:
            leaf = np.full(row_count, -1, np.int32)
            find_leaves(self._vmm.field, records.position[:row_count], leaf)
            self._selection.update(self._vmm, records, leaf, variance=variance, ray_count=ray_count)
            self._light_share.update(self._vmm, records, leaf, variance=variance, ray_count=ray_count)
        fixed = self._fixed_count()
        position, estimate = self._deltas.gathered()
        region_count = len(self._vmm.field.is_ready)
        leaf = np.full(len(position), -1, np.int32)
        if len(position):
            find_leaves(self._vmm.field, position, leaf)
        self._measure(costs)
        self._learning_seconds = time.perf_counter() - started
        allocation = make_allocation(
            mean_by_region(leaf, estimate, region_count),
            ray_count=ray_count, variance=variance, costs=self._costs,
        )
        return Guidance(
            self.settings, self._threshold(next_samples), self._vmm.field, self._probability(), self._light_share.share,
            self._selection.benefit, fixed, allocation, weights,
            self._table.field if method == "TABLE_RIS" and self._table is not None else None, self._network,
            self._probes_only(), self._source.field if self._source is not None else None,
        )

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """Take a finished unit's sums and costs, if guiding is on trial; no two threads at once."""
        if self._trial is None:
            return
        if self._uses_clock:
            cost = costs.seconds
        else:
            cost = costs.ray_count + _GUIDED_COST * costs.guided_vertices
            cost += self._costs.per_candidate * costs.resampled_candidates
            if unit.is_guided:
                cost *= _LEARNING_COST
        self._trial.add(unit.film_index, film.radiance, film.square, unit.sample_count, unit.is_guided)
        self._trial.add_cost(cost, len(unit.pixels) * unit.sample_count, unit.is_guided)

    def _judge(self, tried: GuidingTrial, weights: np.ndarray, next_sample: int, tracing: float) -> None:
        """After an iteration that compared: go on guiding or not. Its guided part took threads `tracing` seconds."""
        efficiency = tried.efficiency(weights)
        if self._uses_clock:
            efficiency /= 1.0 + self._learning_seconds * self._thread_count / max(tracing, 1e-9)
        self._has_won = efficiency >= trial.CLEAR_EFFICIENCY
        # Written so that NaN, nothing compared, goes on.
        if efficiency < trial.LEAST_EFFICIENCY[self._iteration - 1]:
            self._is_over = True
            self.report.stopped_at = next_sample
            self._stop_training()
        self.report.efficiency = efficiency

    def _probability(self) -> np.ndarray:
        """Guiding probability of each region."""
        assert self._vmm is not None
        if self.settings.learn_guiding_probability:
            return self._selection.probability
        return np.full(self._vmm.region_count, self.settings.guiding_probability, np.float32)

    def _fixed_count(self) -> int:
        """Candidates of every vertex, 0 if they are allocated."""
        settings = self.settings
        if settings.guiding_method in SOURCES:
            return 1
        if settings.guiding_method == "VMM_RIS":
            return settings.candidate_count
        return settings.candidate_count if settings.candidate_allocation == "FIXED" else 0

    def _fit(self, records: VertexRecords, row_count: int) -> None:
        started = time.perf_counter()
        position = records.position[:row_count]
        if self._vmm is None:
            bounds = np.stack([position.min(axis=0), position.max(axis=0)])
            self._vmm = VmmModel(bounds)
            self._max_distance = 2.0 * float(np.linalg.norm(bounds[1] - bounds[0]))
            if self.settings.guiding_method == "TABLE_RIS":
                self._table = TableModel()
        np.minimum(records.distance, self._max_distance, out=records.distance)
        self._vmm.update(as_records(records), row_count, self._executor, self._thread_count)
        if self._table is not None:
            self._table.update(self._vmm, self._executor, self._thread_count)
        self.report.region_count = len(self._vmm.field.is_ready)
        self.report.lobe_count = float(self._vmm.field.lobe_count.mean())
        self.report.field_seconds += (time.perf_counter() - started) * self._thread_count

    def _learn_source(
        self, records: VertexRecords, row_count: int, samples: int, recorded_share: float
    ) -> None:
        """Learn what directions are drawn from, if it is not the mixture field."""
        source = self._source
        if source is None:
            return
        started = time.perf_counter()
        source.learn(records, row_count, samples, recorded_share, self._executor, self._thread_count)
        if self.settings.source not in NETWORK_SOURCES:
            self.report.field_seconds += (time.perf_counter() - started) * self._thread_count
        self.report.source, self.report.source_seconds = source.describe(), source.seconds
        self.notices.extend(source.notices)
        source.notices.clear()

    def _train(self, records: VertexRecords, row_count: int, samples: int) -> None:
        trainer = self._trainer
        if trainer is None:
            return
        if row_count:
            trainer.submit(as_records(records), row_count, float(samples))
        if self.settings.deterministic:
            snapshot = trainer.train_until(self._iteration * DETERMINISTIC_STEPS)
        else:
            snapshot = trainer.poll()
        status = trainer.status
        if snapshot is not None:
            self._network = make_network_field(self._shape, snapshot)
            self.report.snapshot_count += 1
            self.report.network_loss = snapshot.loss
            self.report.network_step = snapshot.step
        self.report.training_seconds = status.seconds
        self.report.worker = f"{status.state.value} {status.message}".strip()
        if status.state is TrainerState.DEAD:
            # What it has taught stays in use.
            if self._network is None:
                self._give_up(status.message)
            else:
                self.notices.append(
                    Notice("Guiding / radiance network", status.message, "what it had learned stays in use")
                )
            trainer.close()
            self._trainer = None

    def _weigh_network(self, costs: IterationCosts, recorded_share: float, next_sample: int) -> None:
        """Begin training a network, or give it up, by how many vertices were worth several candidates.

        While there is none the mixture weighs those of recorded paths, and its estimates say what resampling may save.
        """
        is_neural = self.settings.guiding_method == "NEURAL_RIS"
        if not is_neural or not self._weighs_network() or self.report.network_stopped_at or not costs.guided_vertices:
            return
        # Those of recorded paths that only keep the estimates coming do not count.
        resampled = costs.several_vertices / costs.guided_vertices - (float(FLOOR) - 1.0) * recorded_share
        if self._network is None:
            resampled /= max(recorded_share, 1e-6)
        is_worth_it = resampled >= _LEAST_RESAMPLED
        self._worth_count = self._worth_count + 1 if is_worth_it else 0
        # What a network does is known once it weighs candidates.
        is_idle = self.report.has_trained and self._network is None
        self._worthless_count = 0 if is_worth_it or is_idle else self._worthless_count + 1
        if not self.report.has_trained:
            if self._worth_count >= _NETWORK_PATIENCE:
                self._start_network()
        elif self._worthless_count >= _NETWORK_PATIENCE:
            if self._trainer is not None:
                self._end_training()
            self._network = None
            self.report.network_stopped_at = next_sample

    def _measure(self, costs: IterationCosts) -> None:
        """Costs of candidates in rays by the clock, where the image depends on clocks anyway."""
        if not self._uses_clock:
            return
        single_vertices = costs.guided_vertices - costs.several_vertices
        if min(costs.several_vertices, single_vertices) < max(_LEAST_MEASURED * costs.guided_vertices, 1.0):
            return
        per_ray = max(sum(costs.stage_seconds.values()) / max(costs.ray_count, 1), 1e-9)

        def in_rays(count: int, *stages: str) -> float:
            return sum(costs.stage_seconds[name] for name in stages) / count / per_ray

        self._costs = CandidateCosts(
            in_rays(costs.several_candidates, "draw_candidates", "predict_radiance"),
            in_rays(costs.several_vertices, "guide_resample"),
            in_rays(single_vertices, "sample_source"),
        )

    def close(self) -> None:
        """End the worker."""
        self._executor.shutdown(wait=True)
        self._stop_training()

    def _stop_training(self) -> None:
        """End all training."""
        if self._trainer is not None:
            self._end_training()
        if self._source is not None:
            self._source.close()
            self.report.source = self._source.describe()
            self.report.source_seconds = self._source.seconds

    def _end_training(self) -> None:
        assert self._trainer is not None
        status = self._trainer.status
        self.report.training_seconds = status.seconds
        self.report.worker = f"{status.state.value} {status.message}".strip()
        self._trainer.close()
        self._trainer = None
