# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages for a loop in Python: where rays are observed, or something that is no kernel is asked of a model."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace

from engine.ris.candidates import Candidates
from engine.runtime.bundle import Bundle
from engine.runtime.stage_table import StageTable
from engine.wavefront.columns import SHADOW_ROWS
from engine.wavefront.work import LaneQueue, SceneView, UnitView, Work


def python_stages(
    table: StageTable, observer: Callable[..., None] | None, ask: Callable[[Candidates, int, int], bool] | None
) -> SimpleNamespace:
    """The stages by name.

    Parameters
    ----------
    table : StageTable
    observer : callable or None
        See `Tracer.ray_observer`.
    ask : callable or None
        Is asked of a model in its kernel's place (`CandidateModel.ask_elsewhere`).
    """
    stages = table.as_dict()
    if observer is not None:
        closest, shadow = stages["intersect_closest"], stages["intersect_shadow"]

        def intersect_closest(scene: SceneView, unit: UnitView, work: Work, queue: LaneQueue) -> None:
            observer("closest", work.paths, queue.lanes, int(queue.count[0]))
            closest(scene, unit, work, queue)

        def intersect_shadow(scene: SceneView, unit: UnitView, work: Work, queue: LaneQueue) -> None:
            observer("shadow", work.shadows, work.paths, int(work.counts[SHADOW_ROWS]))
            shadow(scene, unit, work, queue)

        stages |= {"intersect_closest": intersect_closest, "intersect_shadow": intersect_shadow}
    if ask is not None:
        ask_kernel = stages["ask_model"]

        def ask_model(memory: Bundle, candidates: Candidates, vertex_count: int, row_count: int) -> None:
            if not ask(candidates, int(vertex_count), int(row_count)):
                ask_kernel(memory, candidates, vertex_count, row_count)

        stages["ask_model"] = ask_model
    return SimpleNamespace(**stages)
