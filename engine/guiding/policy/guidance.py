# SPDX-License-Identifier: GPL-3.0-or-later
"""What one iteration of a guided render goes by: made between iterations, only read while paths are traced."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from engine.guiding.fields.cells.field import CellField
from engine.guiding.fields.roulette.field import RouletteField
from engine.guiding.fields.table import TableField
from engine.guiding.fields.vmm.field import VmmField
from engine.guiding.models.candidate_model import CandidateModel
from engine.ris.orca import Allocation
from engine.runtime.bundle import Bundle
from engine.settings import RenderSettings
from engine.state.lights import LightSelection


@dataclass(frozen=True)
class Guidance:
    """Fields, allocation and how much to record.

    record_threshold : int, paths whose hash is below are recorded: 0 none, 2**32 all
    probability : float32 (R,) or (2 R,), of guiding by region of the field, on surfaces and within media
        (`engine.guiding.models.regions`); so are the rows of `allocation`
    field : VmmField or None, while nothing is known
    light_share : float32 (R,), of sampling a light by region (`engine.guiding.models.light_share`)
    benefit : float32 (R,), of guiding by region (`engine.guiding.models.selection`)
    candidate_count : int, of every guided vertex; 0 = as `allocation` says
    allocation : Allocation
    source : Bundle or None, what to draw directions from if not from `field` (`engine.methods.SOURCES`)
    challenger : Guidance or None, what a part of the iteration's samples goes by instead, to compare
    probes_only : bool, whether it is tried at some vertices of recorded paths, and all others take one candidate
    pixel_weight : float32 (P,), of the film's pixels (`engine.ris.orca.pixel_weights`)
    uses_cache : bool, whether paths end in `cells`, and teach them
    cells : CellField or None, while nothing is known; paths whose hash is below measure_threshold do not end
    roulette_field : RouletteField or None, what roulette goes by; None: by the throughput alone
    table : TableField or None; model : CandidateModel or None. Without both the mixture predicts
    lights : LightSelection or None, which lights to sample, of guided and unguided paths alike; None: the light tree
        chooses, and recorded paths do not say which they have sampled
    guides_media : bool, whether collisions with media are guided and recorded, in scenes that have any
    """

    settings: RenderSettings
    record_threshold: int
    field: VmmField | None = None
    probability: np.ndarray | None = None
    light_share: np.ndarray | None = None
    benefit: np.ndarray | None = None
    candidate_count: int = 1
    allocation: Allocation | None = None
    pixel_weight: np.ndarray | None = None
    table: TableField | None = None
    model: CandidateModel | None = None
    probes_only: bool = False
    source: Bundle | None = None
    challenger: Guidance | None = None
    uses_cache: bool = False
    cells: CellField | None = None
    measure_threshold: int = 0
    roulette_field: RouletteField | None = None
    lights: LightSelection | None = None
    guides_media: bool = True

    def check_regions(self) -> None:
        """Look whether all that is known by region is of the field's regions: kernels look at no index.

        Raises
        ------
        ValueError
            If anything is of more or fewer.
        """
        if self.field is None:
            return
        assert self.probability is not None and self.light_share is not None and self.benefit is not None
        assert self.allocation is not None
        count = len(self.field.is_ready)
        rows = {
            "guiding probability": (len(self.probability), count, 2 * count),
            "candidate allocation": (len(self.allocation.variance_delta), count, 2 * count),
            "light share": (len(self.light_share), count),
            "benefit of guiding": (len(self.benefit), count),
            "table": (count if self.table is None else len(self.table.values), count),
        }
        for name, (found, *expected) in rows.items():
            if found not in expected:
                raise ValueError(f"the {name} knows {found} regions, and the mixture field has {count}")

    def plain(self) -> Guidance:
        """The same without guiding, and without recording."""
        plain = Guidance(self.settings, 0)
        if self.roulette_field is not None:
            plain = plain.with_roulette(self.roulette_field, self.pixel_weight)
        return plain.with_cells(self.cells, self.measure_threshold) if self.uses_cache else plain

    def without_records(self) -> Guidance:
        """The same, but nothing is recorded."""
        return replace(self, record_threshold=0, challenger=None)

    @property
    def newest_pixel_weight(self) -> np.ndarray | None:
        """Weights of the pixels, if it or its challenger asks for them."""
        challenger = self.challenger
        return self.pixel_weight if self.pixel_weight is not None or challenger is None else challenger.pixel_weight

    def with_pixel_weight(self, pixel_weight: np.ndarray | None) -> Guidance:
        """The same, for other pixels."""
        challenger = None if self.challenger is None else self.challenger.with_pixel_weight(pixel_weight)
        return replace(self, pixel_weight=pixel_weight, challenger=challenger)

    def with_regions(
        self, field: VmmField, probability: np.ndarray, light_share: np.ndarray, benefit: np.ndarray,
        allocation: Allocation, pixel_weight: np.ndarray | None, *, guides_media: bool,
    ) -> Guidance:
        """The same, guided by the mixture field and what its regions have learned."""
        return replace(
            self, field=field, probability=probability, light_share=light_share, benefit=benefit,
            allocation=allocation, pixel_weight=pixel_weight, guides_media=guides_media,
        )

    def with_roulette(self, roulette_field: RouletteField, pixel_weight: np.ndarray | None) -> Guidance:
        """The same, with roulette by what surfaces send back."""
        challenger = None if self.challenger is None else self.challenger.with_roulette(roulette_field, pixel_weight)
        return replace(self, roulette_field=roulette_field, pixel_weight=pixel_weight, challenger=challenger)

    def with_cells(self, cells: CellField | None, measure_threshold: int) -> Guidance:
        """The same, with paths that end in these cells."""
        challenger = None if self.challenger is None else self.challenger.with_cells(cells, measure_threshold)
        return replace(
            self, uses_cache=True, cells=cells, measure_threshold=measure_threshold, challenger=challenger
        )
