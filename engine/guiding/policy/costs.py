# SPDX-License-Identifier: GPL-3.0-or-later
"""What methods cost, in rays or by the clock."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, fields

from engine.guiding.policy.rules import RULES, Rules
from engine.ris.orca import CandidateCosts
from engine.state.unit import PLAIN, UnitCosts


@dataclass
class IterationCosts:
    """What the iteration's threads measured."""

    stage_seconds: Counter[str]
    ray_count: int
    path_count: int
    guided_vertices: int
    several_vertices: int
    several_candidates: int
    #: Records that there was no room for.
    dropped_records: int = 0
    #: Rays that looked for the next surface.
    closest_count: int = 0

    def __add__(self, other: IterationCosts) -> IterationCosts:
        return IterationCosts(*(getattr(self, one.name) + getattr(other, one.name) for one in fields(self)))


class MethodCosts:
    """Costs of candidates by method, and of units of work.

    Parameters
    ----------
    candidates : mapping of str to CandidateCosts
        Costs of each method, before there is anything to measure.
    uses_clock : bool
        Whether the image may depend on the clock.
    rules : Rules

    Attributes
    ----------
    uses_clock : bool
    """

    def __init__(
        self, candidates: Mapping[str, CandidateCosts], *, uses_clock: bool, rules: Rules = RULES
    ) -> None:
        self._rules = rules
        self.begin(candidates, uses_clock=uses_clock)

    def begin(self, candidates: Mapping[str, CandidateCosts], *, uses_clock: bool) -> None:
        """Begin with costs of candidates by method, and with or without the clock."""
        self._candidates = dict(candidates)
        self.uses_clock = uses_clock

    def candidates(self, method: str) -> CandidateCosts:
        """Costs of candidates in rays."""
        return self._candidates.get(method, CandidateCosts())

    def unit(self, costs: UnitCosts, arm: int, method: str) -> float:
        """Cost of a unit that one of a comparison's arms rendered: seconds, or rays where no clock may be asked."""
        if self.uses_clock:
            return costs.seconds
        cost = costs.ray_count + self._rules.guided_cost * costs.guided_vertices
        cost += self.candidates(method).per_candidate * costs.resampled_candidates
        return cost if arm == PLAIN else cost * self._rules.learning_cost

    def measure(self, method: str, costs: IterationCosts) -> None:
        """Take the costs of an iteration that `method` alone rendered, where the clock may be asked."""
        if not self.uses_clock:
            return
        single_vertices = costs.guided_vertices - costs.several_vertices
        if min(costs.several_vertices, single_vertices) < max(self._rules.least_measured * costs.guided_vertices, 1.0):
            return
        per_ray = max(sum(costs.stage_seconds.values()) / max(costs.ray_count, 1), 1e-9)

        def in_rays(count: int, *stages: str) -> float:
            return sum(costs.stage_seconds[name] for name in stages) / count / per_ray

        self._candidates[method] = CandidateCosts(
            in_rays(costs.several_candidates, "draw_candidates", "predict_radiance"),
            in_rays(costs.several_vertices, "guide_resample"),
            in_rays(single_vertices, "sample_source"),
        )
