# SPDX-License-Identifier: GPL-3.0-or-later
"""What a source of directions has to bring: lanes, kernels to sample them by, and a model that learns."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, NamedTuple, Protocol

from engine.guiding.models.source_model import SourceModel
from engine.runtime.bundle import Bundle
from engine.runtime.jit import kernel
from engine.settings import RenderSettings


class GuideKernels(NamedTuple):
    """How lanes of one kind are sampled: kernels, but for `with_field`.

    with_field : (guide, field) -> guide
        The same lanes for what has been learned; None: nothing but the mixture field.
    ready : (guide, lane, field, region, points, closures, is_diffuse, bits) -> bool
        Make a lane ready to be sampled, if it can be. `field` and `region` are of the mixture field (-1: it knows
        nothing here), `bits` random.
    ready_collision : (guide, lane, field, region, points, closures, bits) -> bool
        The same at a collision with a medium; the closures are phase functions, and the point's normal is where the
        path was going.
    sample : (guide, lane, u0, u1, u2) -> unit direction
    eval : (guide, lane, wi) -> float32 [sr^-1], density of `sample`
    predict : (guide, lane, wi, guide_pdf) -> float32, incident radiance along wi, mean over channels
    eval_wavelengths : (guide, lane, wi, out, row, column) -> bool
        Whether the density depends on the wavelength. If so, those of all the path's wavelengths, had each been the
        hero, are written to `out`; `eval` is their mean by their shares.
    query : (guide, guided, paths, points, lanes, lane_count)
        Make all lanes ready that `ready` has agreed to.
    ask : (guide, lane), have a lane's data brought to the cache
    """

    with_field: Callable[[Any, Any], Any]
    ready: Any
    ready_collision: Any
    sample: Any
    eval: Any
    predict: Any
    eval_wavelengths: Any
    query: Any
    ask: Any


class Implementation(Protocol):
    """A module that `engine.methods.SOURCES` names."""

    #: By class of lanes.
    KERNELS: Mapping[type[Bundle], GuideKernels]

    def allocate(self, settings: RenderSettings, lane_count: int) -> Bundle:
        """Lanes for the source that `settings.source` names; it has learned nothing."""

    def make_model(self, settings: RenderSettings) -> SourceModel | None:
        """What learns it; None if that is the mixture field."""

    def target(self, settings: RenderSettings, *, is_diffuse: bool) -> str:
        """What its directions come closest to: 'RADIANCE', or 'PRODUCT' with the BSDF and the cosine."""


@kernel
def query_nothing(guide, guided, paths, points, lanes, lane_count):
    """Lanes that were made ready one by one."""


@kernel
def is_same_at_all(guide, lane, wi, out, row, column):
    """A distribution that knows no wavelengths."""
    return False


@kernel
def ask_for_nothing(guide, lane):
    """A lane whose data are few, or not known ahead."""
