# SPDX-License-Identifier: GPL-3.0-or-later
"""What stages sample by, whichever source has learned it: one interface for all, chosen when a stage is compiled.

A guide is a bundle of lanes. `ready_guide` says for a lane whether there is anything to sample by, `ready_collision`
says so within media; once that has been
asked of all lanes of a round, `query_guides` does what is better done for many at once. Then `eval_guide` is the
density of `sample_guide`, and `predict_guide` says what radiance to expect from a direction. Arguments and results are
those of `engine.guiding.sources.guide_kernels.GuideKernels`.
"""

from __future__ import annotations

from typing import Any

from engine.guiding.fields.vmm.query import eval_vmm, predict_vmm, sample_vmm
from engine.guiding.sources import implementation, kernels_of
from engine.guiding.sources.guide_kernels import is_same_at_all, query_nothing
from engine.guiding.sources.vmm import ask_for_lobes, ready_vmm, ready_vmm_collision
from engine.runtime.bundle import Bundle
from engine.runtime.jit import by_bundle
from engine.settings import RenderSettings


def allocate_guide_of(settings: RenderSettings, lane_count: int) -> Bundle:
    """Lanes for the source of directions that the settings ask for; it has learned nothing."""
    return implementation(settings.source).allocate(settings, lane_count)


def with_field(guide: Bundle, field: Any) -> Bundle:
    """The same lanes for what has been learned; None: nothing but the mixture field."""
    return kernels_of(type(guide).__name__).with_field(guide, field)


ready_guide = by_bundle(lambda guide: kernels_of(guide).ready, like=ready_vmm)
ready_collision = by_bundle(lambda guide: kernels_of(guide).ready_collision, like=ready_vmm_collision)
query_guides = by_bundle(lambda guide: kernels_of(guide).query, like=query_nothing)
ask_for_guide = by_bundle(lambda guide: kernels_of(guide).ask, like=ask_for_lobes)
eval_guide = by_bundle(lambda guide: kernels_of(guide).eval, like=eval_vmm)
eval_wavelengths = by_bundle(lambda guide: kernels_of(guide).eval_wavelengths, like=is_same_at_all)
sample_guide = by_bundle(lambda guide: kernels_of(guide).sample, like=sample_vmm)
predict_guide = by_bundle(lambda guide: kernels_of(guide).predict, like=predict_vmm)
