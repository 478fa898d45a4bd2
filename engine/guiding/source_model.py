# SPDX-License-Identifier: GPL-3.0-or-later
"""Learning what directions are drawn from, where that is not the mixture field: one face for trees and networks."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from typing import Protocol

import numpy as np

from engine.guiding.flow.field import make_flow_field
from engine.guiding.flow.shape import FlowShape
from engine.guiding.guide import SourceField
from engine.guiding.mixture.inference import make_mixture_network
from engine.guiding.mixture.shape import SHUTTER_SPAN, selection_blend
from engine.guiding.rows import make_rows
from engine.guiding.sdtree.model import SdTreeModel
from engine.guiding.sources import source_shape, source_training
from engine.guiding.trainer import NetworkTrainer, TrainerState
from engine.guiding.vertices import VertexRecords, compensate
from engine.scene.arrays import Float32Array
from engine.scene.description import Notice
from engine.settings import NETWORK_SOURCES, RenderSettings

#: Records that a cell holds before it is cut, times the root of the passes: the authors' figure for passes of one
#: sample, which our records, thinned as they are, come closest to (docs/experiments.md).
_PLAIN_THRESHOLD = 4000.0
#: Rath et al. 2020's sizes of the variance-aware tree: finer in space and in direction than the plain one.
_VARIANCE_THRESHOLD = 2000.0
_VARIANCE_FLUX_SHARE = 0.005
#: Steps of training between two iterations where it must not depend on clocks.
DETERMINISTIC_STEPS = 64


class SourceModel(Protocol):
    """Learns a `SourceField` from the records of each iteration."""

    #: What has been learned, None while nothing has.
    field: SourceField | None
    #: Processor time of learning in other processes [s].
    seconds: float
    notices: list[Notice]

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        """Learn from the records of `samples` samples a pixel, of which a share of the paths was recorded."""

    def describe(self) -> str:
        """What was learned, in a line for people."""

    def close(self) -> None:
        """Stop learning; what was learned stays."""


class TreeSource:
    """An SD-tree, learned between iterations."""

    def __init__(self, settings: RenderSettings) -> None:
        self.field: SourceField | None = None
        self.seconds = 0.0
        self.notices: list[Notice] = []
        self._is_variance_aware = settings.source == "SDTREE_VARIANCE"
        self._seed = settings.seed
        self._compensates = settings.mis_compensation
        self._guiding_probability = settings.guiding_probability
        self._model: SdTreeModel | None = None

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        if row_count == 0:
            return
        if self._model is None:
            position = records.position[:row_count]
            bounds = np.stack([position.min(axis=0), position.max(axis=0)])
            if self._is_variance_aware:
                self._model = SdTreeModel(
                    bounds, spatial_threshold=_VARIANCE_THRESHOLD, flux_share=_VARIANCE_FLUX_SHARE,
                    is_variance_aware=True, seed=self._seed,
                )  # fmt: skip
            else:
                self._model = SdTreeModel(bounds, spatial_threshold=_PLAIN_THRESHOLD, seed=self._seed)
        if self._compensates:
            records = compensate(records, row_count, self._guiding_probability)
        # The paper's thresholds are for paths that all leave records.
        self._model.update(records, row_count, samples * recorded_share, executor, thread_count)
        self.field = self._model.field

    def describe(self) -> str:
        return "" if self._model is None else f"SD-tree: {self._model.region_count} regions"

    def close(self) -> None:
        """Nothing runs between iterations."""


class NetworkSource:
    """A network, trained in a process of its own."""

    def __init__(self, settings: RenderSettings) -> None:
        self.field: SourceField | None = None
        self.seconds = 0.0
        self.notices: list[Notice] = []
        self._name = settings.source
        self._is_deterministic = settings.deterministic
        self._shape = source_shape(settings)
        # Mixtures are trained to compensate (`source_training`).
        self._compensates = settings.mis_compensation and isinstance(self._shape, FlowShape)
        self._guiding_probability = settings.guiding_probability
        #: By which a wavelength is picked for each row, where the network sees one.
        self._wavelengths = (
            np.random.Generator(np.random.Philox(settings.seed)) if settings.u_dimension == "WAVELENGTH" else None
        )
        self._samples = 0.0
        self._step_limit = 0
        self._snapshot_count = 0
        self._state = ""
        self._trainer: NetworkTrainer | None = NetworkTrainer(
            self._shape, seed=settings.seed, training_share=settings.training_share,
            deterministic=settings.deterministic, settings=source_training(settings),
        )
        self._trainer.start()

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        self._samples += samples
        trainer = self._trainer
        if trainer is None:
            return
        if self._compensates:
            records = compensate(records, row_count, self._guiding_probability)
        rows = training_rows(records, row_count, wavelengths=self._wavelengths)
        if len(rows):
            trainer.submit(rows, len(rows), samples)
        if self._is_deterministic:
            self._step_limit += DETERMINISTIC_STEPS
            snapshot = trainer.train_until(self._step_limit)
        else:
            snapshot = trainer.poll()
        if snapshot is not None:
            self._snapshot_count += 1
            if isinstance(self._shape, FlowShape):
                self.field = make_flow_field(self._shape, snapshot)
            else:
                self.field = make_mixture_network(self._shape, snapshot, selection_blend(self._samples))
        status = trainer.status
        self._note(trainer)
        if status.state is TrainerState.DEAD:
            effect = "the mixture field guides instead" if self.field is None else "what it had learned stays in use"
            self.notices.append(Notice(f"Guiding / {self._name}", status.message, effect))
            trainer.close()
            self._trainer = None

    def _note(self, trainer: NetworkTrainer) -> None:
        status = trainer.status
        self.seconds = status.seconds
        worker = f"{status.state.value} {status.message}".strip()
        self._state = f"{status.step} steps, loss {status.loss:.3g}, worker {worker}"

    def describe(self) -> str:
        return f"{self._name}: {self._snapshot_count} snapshots, {self._state}"

    def close(self) -> None:
        if self._trainer is not None:
            self._note(self._trainer)
            self._trainer.close()
            self._trainer = None


class TrainedSource:
    """A network that was trained before the render; it learns nothing more.

    Parameters
    ----------
    field : SourceField or None
        None: the mixture field guides.
    u_dimension : str
        What the network knows, 'TIME' or 'NONE' (`engine.settings.U_DIMENSIONS`).
    description : str
        What was trained, in a line for people.
    """

    def __init__(self, field: SourceField | None, u_dimension: str, description: str = "") -> None:
        self.field = field
        self.u_dimension = u_dimension
        self.seconds = 0.0
        self.notices: list[Notice] = []
        self._description = description

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        pass

    def describe(self) -> str:
        return self._description

    def close(self) -> None:
        """Nothing runs."""


class RowCollector(TrainedSource):
    """Such a network, or none yet, while rows are collected to train it further when the render is over.

    u_span : (float, float), u at the shutter's opening and closing
    rows : list of float32 (N, ROW_WIDTH)
    """

    def __init__(self, field: SourceField | None, u_dimension: str, u_span: tuple[float, float]) -> None:
        super().__init__(field, u_dimension)
        self.u_span = u_span
        self.rows: list[Float32Array] = []

    def learn(
        self, records: VertexRecords, row_count: int, samples: float, recorded_share: float,
        executor: ThreadPoolExecutor, thread_count: int,
    ) -> None:
        self.rows.append(training_rows(records, row_count, self.u_span))


def training_rows(
    records: VertexRecords, row_count: int, u_span: tuple[float, float] = SHUTTER_SPAN,
    wavelengths: np.random.Generator | None = None,
) -> Float32Array:
    """Rows to train a network with: float32 (at most row_count, ROW_WIDTH).

    Parameters
    ----------
    u_span : (float, float)
        u at the shutter's opening and closing.
    wavelengths : numpy.random.Generator or None
        Give u: that of a wavelength, picked from each record's by what light it has there, which stands for a row for
        each of them; else that of the time.
    """
    if wavelengths is None:
        # As `inference.u_of_time` has it.
        first_u, last_u = np.float32(u_span[0]), np.float32(u_span[1])
        u = first_u + (last_u - first_u) * records.time[:row_count]
    else:
        u = _picked_wavelengths(records.hero[:row_count], records.spectrum[:row_count], wavelengths)
    bsdf_pdf, guide_pdf = records.bsdf_pdf[:row_count], records.guide_pdf[:row_count]
    pdf = records.pdf[:row_count]
    # A vertex that was not guided drew from its BSDF.
    return make_rows(
        records.position[:row_count], records.direction[:row_count], records.wo[:row_count],
        records.normal[:row_count],
        roughness=records.surface_roughness[:row_count],
        radiance=records.radiance[:row_count].mean(axis=1),
        reflectance=records.reflectance[:row_count],
        pdf=pdf,
        bsdf_pdf=np.where(np.isnan(bsdf_pdf), pdf, bsdf_pdf),
        guide_pdf=np.where(np.isnan(guide_pdf), np.float32(0.0), guide_pdf),
        u=u,
    )


def _picked_wavelengths(
    hero: Float32Array, spectrum: Float32Array, rng: np.random.Generator
) -> Float32Array:
    """Number in [0, 1) of one wavelength of each record, as often as it has light there; the hero's where all is dark.

    Parameters
    ----------
    hero : float32 (N,); spectrum : float32 (N, C)
        See `VertexRecords`.
    """
    upto = np.cumsum(np.nan_to_num(spectrum, nan=0.0, posinf=0.0), axis=1, dtype=np.float64)
    place = rng.random(len(hero)) * upto[:, -1]
    picked = (place[:, None] >= upto).sum(axis=1) % spectrum.shape[1]
    return np.mod(hero + picked / np.float32(spectrum.shape[1]), 1.0).astype(np.float32)


def make_source_model(settings: RenderSettings) -> SourceModel | None:
    """What learns the source of directions, None if the mixture field is it."""
    if settings.source == "VMM":
        return None
    return NetworkSource(settings) if settings.source in NETWORK_SOURCES else TreeSource(settings)
