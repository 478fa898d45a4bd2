# SPDX-License-Identifier: GPL-3.0-or-later
"""Between the iterations of a guided render: what paths recorded becomes the next iteration's guidance.

The lengths of iterations and the weights with which they enter the image are functions of their index alone, never of
what was sampled, so the mean stays unbiased. What is learned concerns distributions and candidate counts only.
"""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from engine.film import Film, FilmTile
from engine.guidance import Guidance
from engine.guiding import trial
from engine.guiding.choice import Choice
from engine.guiding.light_share import LightShareModel
from engine.guiding.network import network_shape
from engine.guiding.network_query import NetworkField, make_network_field
from engine.guiding.report import GuidingReport
from engine.guiding.selection import SelectionModel
from engine.guiding.source_model import (
    DETERMINISTIC_STEPS,
    NetworkSource,
    RowCollector,
    SourceModel,
    TrainedSource,
    TreeSource,
    make_source_model,
)
from engine.guiding.table import TableModel
from engine.guiding.trainer import NetworkTrainer, TrainerState
from engine.guiding.trial import Part
from engine.guiding.vertices import (
    VertexRecords,
    allocate_vertex_records,
    as_records,
    as_records_by_quarter,
    compensate,
)
from engine.guiding.vmm.leaves import find_leaves
from engine.guiding.vmm.model import VmmModel
from engine.ris.orca import (
    FLOOR,
    PROBED_SHARE,
    Allocation,
    CandidateCosts,
    VarianceDeltas,
    image_variance,
    make_allocation,
    mean_by_region,
    pixel_weights,
)
from engine.scene.description import Notice
from engine.settings import NETWORK_SOURCES, SOURCES, RenderSettings
from engine.work import CHALLENGER, PLAIN, Unit, UnitCosts

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
#: With AUTO: what a render must still take for a network to be trained at all, in seconds or, without a clock, paths.
_LEAST_TIME_LEFT = 20.0
_LEAST_PATHS_LEFT = 6e6
#: With AUTO: iterations that a table learns from before it is tried.
_TABLE_UPDATES = 3
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
    source : TrainedSource, optional
        What directions are drawn from, instead of what the settings would have this render learn.
    """

    def __init__(
        self, settings: RenderSettings, thread_count: int, paths_per_sample: int, source: TrainedSource | None = None
    ) -> None:
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
        #: Of each method, as far as they are not those of the statistical fields.
        self._costs = {"NEURAL_RIS": CandidateCosts(per_candidate=_NEURAL_CANDIDATE_COST)}
        self._network: NetworkField | None = None
        #: Iterations running in which a network would have been worth its time, or not.
        self._worth_count = self._worthless_count = 0
        self._iteration = 0
        self._started = time.perf_counter()
        self._is_auto = settings.guiding_method == "AUTO"
        rung = "VMM" if self._is_auto else settings.guiding_method
        self._choice = Choice(paths_per_sample, rung, tries_plain=settings.guiding_trial)
        self._is_over = False
        #: Where a statistical method and samples are given, the image does not depend on clocks.
        is_asynchronous = settings.guiding_method in ("AUTO", "NEURAL_RIS") or (
            source is None and settings.source in NETWORK_SOURCES
        )
        depends_on_clock = is_asynchronous or settings.time_limit > 0.0
        self._uses_clock = depends_on_clock and not settings.deterministic
        self._learning_seconds = 0.0
        self._trainer: NetworkTrainer | None = None
        #: When training was last asked for its time, and that time.
        self._training_asked = self._started, 0.0
        self.report = GuidingReport(method=settings.guiding_method, chosen=rung, trials=self._choice.trials)
        self._source: SourceModel | None = make_source_model(settings) if source is None else source
        if settings.guiding_method == "NEURAL_RIS" and not self._weighs_network():
            self._start_network()
        if settings.radiance_cache and settings.guiding_method not in ("TABLE_RIS", "NEURAL_RIS"):
            # The mixture knows no colour.
            problem = "works with TABLE_RIS and NEURAL_RIS only"
            self.notices.append(Notice("Guiding / radiance cache", problem, "paths are not cut short"))

    def _weighs_network(self) -> bool:
        """Whether the network may be left out: not where a number of candidates or the cache was asked for."""
        return self.settings.candidate_allocation == "ORCA" and not self.settings.radiance_cache

    def _probes_only(self, rung: str) -> bool:
        """Whether allocation is only tried: of a coarse method, or for want of a network that it would be for."""
        if self._is_auto:
            return rung == "VMM"
        return rung == "NEURAL_RIS" and self._weighs_network() and self._network is None

    @property
    def parts(self) -> list[Part]:
        """Parts of the iteration in work."""
        return self._choice.parts

    @property
    def is_over(self) -> bool:
        """Whether guiding has been given up: there is nothing more to learn."""
        return self._is_over

    def _start_network(self) -> None:
        self.report.has_trained = True
        self._shape = network_shape(self.settings)
        self._trainer = NetworkTrainer(
            self._shape, seed=self.settings.seed, training_share=self.settings.training_share,
            deterministic=self.settings.deterministic,
        )
        self._trainer.start()
        self._training_asked = time.perf_counter(), 0.0

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
        records = allocate_vertex_records(256, self.settings.channel_count)
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
            model = TableModel(channel_count=self.settings.channel_count)
            model.update(vmm)
            table = model.field
        allocation = make_allocation(np.zeros(1, np.float32), ray_count=1.0, variance=1.0, costs=CandidateCosts())
        ones = np.ones(1, np.float32)
        return Guidance(
            self.settings, 0, vmm.field, ones, ones, ones, 1, allocation,
            np.ones(self._paths_per_sample, np.float32), table,
        )

    def _threshold(self, samples: float) -> int:
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
        guided_share = self._choice.guided_share
        samples = sum(part.sample_count for part in self.parts) * guided_share
        sums = film.sums
        weight = np.maximum(sums.weight, 1e-20)[:, None]
        mean = sums.radiance / weight
        weights = pixel_weights(
            mean.reshape(film.height, film.width, -1), is_relative=self.settings.orca_error == "RELATIVE"
        )
        self._judge(weights, next_range[0], guided_share * sum(costs.stage_seconds.values()))
        if self._is_over:
            self._choice.plan(*next_range, (), knows_something=False)
            return Guidance(self.settings, 0)
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
            self._choice.plan(*next_range, (), knows_something=False)
            return Guidance(self.settings, self._threshold(next_range[1]))
        if row_count:
            self._deltas.add(records.position[:row_count], records.benefit[:row_count])
        self._weigh_network(costs, recorded_share, next_range[0])
        self._train(records, row_count, samples)
        self._learn_source(records, row_count, samples, recorded_share)

        ray_count = costs.ray_count / max(costs.path_count, 1)
        variance = image_variance(mean, sums.square / weight, weights)
        if row_count:
            leaf = np.full(row_count, -1, np.int32)
            find_leaves(self._vmm.field, records.position[:row_count], leaf)
            self._selection.update(self._vmm, records, leaf, variance=variance, ray_count=ray_count)
            if self._iteration == 1:
                # Pixels had no weights yet: what lights brought was multiplied by zero.
                records.light_squared[:row_count] = np.nan
            self._light_share.update(self._vmm, records, leaf, variance=variance, ray_count=ray_count)
        position, estimate = self._deltas.gathered()
        region_count = len(self._vmm.field.is_ready)
        leaf = np.full(len(position), -1, np.int32)
        if len(position):
            find_leaves(self._vmm.field, position, leaf)
        self._measure(costs)
        self._choice.plan(*next_range, self._offers(next_range[0]))
        samples = next_range[1] * self._choice.guided_share
        delta = mean_by_region(leaf, estimate, region_count)
        self._learning_seconds = time.perf_counter() - started

        def allocate(rung: str) -> Allocation:
            return make_allocation(delta, ray_count=ray_count, variance=variance, costs=self._costs_of(rung))

        return self._guidance(allocate, weights, samples)

    def _costs_of(self, rung: str) -> CandidateCosts:
        return self._costs.get(rung, CandidateCosts())

    def _guidance(self, allocate: Callable[[str], Allocation], weights: np.ndarray, samples: float) -> Guidance:
        """What the next iteration's guided samples, so many a pixel, go by."""
        assert self._vmm is not None
        field, choice = self._vmm.field, self._choice
        probability = self._probability()
        self.report.chosen = choice.rung
        ready = field.is_ready != 0
        self.report.guided_share = float((probability[ready] > 0.0).sum() / max(ready.sum(), 1))

        def by(rung: str, challenger: Guidance | None = None) -> Guidance:
            return Guidance(
                self.settings, self._threshold(samples), field, probability, self._light_share.share,
                self._selection.benefit, self._fixed_count(rung), allocate(rung), weights,
                self._table.field if rung == "TABLE_RIS" and self._table is not None else None,
                self._network if rung == "NEURAL_RIS" else None,
                self._probes_only(rung), self._source.field if self._source is not None else None, challenger,
            )

        return by(choice.rung, by(choice.challenger) if choice.challenger else None)

    @property
    def keeps_all_records(self) -> bool:
        """Whether the records of the last iteration, which nothing in this render can learn from, are wanted too."""
        return isinstance(self._source, RowCollector)

    def keep(self, units: Sequence[VertexRecords], recorded_share: float) -> None:
        """Take the records of the last iteration, for who trains after this render."""
        assert self._source is not None
        records, row_count = _joined(units)
        self._source.learn(records, row_count, 0.0, recorded_share, self._executor, self._thread_count)

    def compare(self, unit: Unit, film: FilmTile, costs: UnitCosts) -> None:
        """Take a finished unit's sums and costs, if methods are compared; no two threads at once."""
        if self._is_over:
            return
        if self._uses_clock:
            cost = costs.seconds
        else:
            cost = costs.ray_count + _GUIDED_COST * costs.guided_vertices
            rung = self._choice.challenger if unit.arm == CHALLENGER else self._choice.rung
            cost += self._costs_of(rung).per_candidate * costs.resampled_candidates
            if unit.arm != PLAIN:
                cost *= _LEARNING_COST
        self._choice.compare(unit, film, cost)

    def _judge(self, weights: np.ndarray, next_sample: int, tracing: float) -> None:
        """Conclude what the iteration compared, if it did. Its guided part took threads `tracing` seconds."""
        choice = self._choice
        overhead = 0.0
        if self._uses_clock:
            learning = 0.0 if choice.challenger else self._learning_seconds * self._thread_count
            training = self._training_share() if choice.challenger == "NEURAL_RIS" else 0.0
            overhead = learning / max(tracing, 1e-9) + training
        choice.judge(weights, next_sample, overhead)
        self.report.efficiency = choice.efficiency
        if not choice.has_lost:
            return
        if isinstance(self._source, (NetworkSource, TrainedSource)) and self._source.field is not None:
            self._end_source()
            self._source = None
            self.report.source_stopped_at = next_sample
            # What stands in for it has long been learning: no more benefit of the doubt.
            choice.restart(trial.LAST_DOUBT)
        else:
            self._is_over = True
            self.report.stopped_at = next_sample
            self.report.chosen = "OFF"
            self._stop_training()

    def _probability(self) -> np.ndarray:
        """Guiding probability of each region."""
        assert self._vmm is not None
        if self.settings.learn_guiding_probability:
            return self._selection.probability
        return np.full(self._vmm.region_count, self.settings.guiding_probability, np.float32)

    def _fixed_count(self, rung: str) -> int:
        """Candidates of every vertex, 0 if they are allocated."""
        settings = self.settings
        if self._is_auto:
            return 0
        if rung in SOURCES:
            return 1
        if rung == "VMM_RIS":
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
                self._table = TableModel(channel_count=self.settings.channel_count)
        np.minimum(records.distance, self._max_distance, out=records.distance)
        self._vmm.update(as_records(records), row_count, self._executor, self._thread_count)
        if self._table is not None:
            self._table.update(self._vmm, self._executor, self._thread_count)
        self.report.region_count = len(self._vmm.field.is_ready)
        self.report.lobe_count = float(self._vmm.field.lobe_count.mean())
        self.report.field_seconds += (time.perf_counter() - started) * self._thread_count

    def _learn_source(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float
    ) -> None:
        """Learn what directions are drawn from, if it is not the mixture field."""
        source = self._source
        if source is None:
            return
        started = time.perf_counter()
        had_field = source.field is not None
        source.learn(records, row_count, samples, recorded_share, self._executor, self._thread_count)
        if self.settings.source not in NETWORK_SOURCES:
            self.report.field_seconds += (time.perf_counter() - started) * self._thread_count
        if isinstance(source, NetworkSource) and source.field is not None and not had_field:
            # What was tried so far was the mixture field.
            self._choice.restart(trial.BEFORE_FIRST)
        self.report.source, self.report.source_seconds = source.describe(), source.seconds
        self.notices.extend(source.notices)
        source.notices.clear()

    def _train(self, records: VertexRecords, row_count: int, samples: float) -> None:
        trainer = self._trainer
        if trainer is None:
            return
        if row_count:
            by_quarter = self._shape.by_quarter
            light = as_records_by_quarter(records, row_count) if by_quarter else as_records(records)
            trainer.submit(light, row_count, samples)
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
        if not self._weighs_network() or self.report.network_stopped_at or not costs.guided_vertices:
            return
        if self._is_auto:
            if self._choice.rung == "VMM" and not self._choice.challenger:
                self._count_worth(costs, recorded_share, is_probing=True)
            return
        if self.settings.guiding_method != "NEURAL_RIS":
            return
        is_worth_it = self._count_worth(costs, recorded_share, is_probing=self._network is None)
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

    def _count_worth(self, costs: IterationCosts, recorded_share: float, *, is_probing: bool) -> bool:
        """Whether enough of an iteration's vertices were worth several candidates; how many times running is counted.

        Parameters
        ----------
        is_probing : bool
            Only a share of the vertices of recorded paths had the choice.
        """
        probed = recorded_share * PROBED_SHARE
        had_choice = probed if is_probing else 1.0
        # Those of recorded paths that only keep the estimates coming do not count.
        for_estimates = (float(FLOOR) - 1.0) * (probed if is_probing else recorded_share)
        resampled = (costs.several_vertices / costs.guided_vertices - for_estimates) / max(had_choice, 1e-6)
        is_worth_it = resampled >= _LEAST_RESAMPLED
        self._worth_count = self._worth_count + 1 if is_worth_it else 0
        return is_worth_it

    def _offers(self, next_sample: int) -> list[str]:
        """Methods to compare with the one in use, finer ones first, where resampling promises to pay.

        What a finer one needs is made once those before it have been compared.
        """
        choice = self._choice
        is_promising = self._worth_count >= _NETWORK_PATIENCE or choice.rung != "VMM" or choice.challenger != ""
        if not self._is_auto or not is_promising:
            return []
        offers = ["VMM_RIS"]
        if choice.has_tried("VMM_RIS"):
            if not choice.has_use_for("TABLE_RIS", next_sample):
                self._table = None
            elif self._table is None:
                assert self._vmm is not None
                self._table = TableModel(self._vmm.region_count, self.settings.channel_count)
            elif self._table.update_count >= _TABLE_UPDATES:
                offers.append("TABLE_RIS")
        if choice.has_tried("TABLE_RIS"):
            if self._network is not None:
                offers.append("NEURAL_RIS")
            elif not self.report.has_trained and self._is_long(next_sample):
                self._start_network()
        if choice.has_tried("NEURAL_RIS") and choice.rung != "NEURAL_RIS" and self._trainer is not None:
            self._end_training()
            self._network = None
        return [*offers, "VMM"]

    def _is_long(self, next_sample: int) -> bool:
        """Whether what is left of the render is worth training a network for."""
        samples_left = self.settings.samples - next_sample
        if not self._uses_clock:
            return samples_left * self._paths_per_sample >= _LEAST_PATHS_LEFT
        elapsed = time.perf_counter() - self._started
        left = elapsed * samples_left / max(next_sample, 1)
        if self.settings.time_limit > 0.0:
            left = min(left, self.settings.time_limit - elapsed)
        return left >= _LEAST_TIME_LEFT

    def _training_share(self) -> float:
        """Processor time that training took since it was last asked, as a share of all there was."""
        if self._trainer is None:
            return 0.0
        now, seconds = time.perf_counter(), self._trainer.status.seconds
        since, before = self._training_asked
        self._training_asked = now, seconds
        return min((seconds - before) / max((now - since) * self._thread_count, 1e-9), 1.0)

    def _measure(self, costs: IterationCosts) -> None:
        """Costs of candidates in rays by the clock, where the image depends on clocks anyway."""
        # Costs of an iteration that compares are those of two methods.
        if not self._uses_clock or len(self.parts) > 1:
            return
        single_vertices = costs.guided_vertices - costs.several_vertices
        if min(costs.several_vertices, single_vertices) < max(_LEAST_MEASURED * costs.guided_vertices, 1.0):
            return
        per_ray = max(sum(costs.stage_seconds.values()) / max(costs.ray_count, 1), 1e-9)

        def in_rays(count: int, *stages: str) -> float:
            return sum(costs.stage_seconds[name] for name in stages) / count / per_ray

        self._costs[self._choice.rung] = CandidateCosts(
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
            self._end_source()

    def _end_source(self) -> None:
        assert self._source is not None
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
