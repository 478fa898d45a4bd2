# SPDX-License-Identifier: GPL-3.0-or-later
"""The sources of directions, a module for each kind, found by `engine.methods.SOURCES`.

A module is imported when a render first uses it; those with networks lie in `engine.guiding.neural.sources`.
"""

from __future__ import annotations

from importlib import import_module
from typing import cast

from engine.guiding.models.source_model import SourceModel
from engine.guiding.sources.guide_kernels import GuideKernels, Implementation
from engine.methods import SOURCES
from engine.settings import RenderSettings

#: Packages whose modules are found by name: kernels that were compiled for one are compiled anew when it changes
#: (`engine.runtime.sources`).
FOUND_BY_NAME = (".", "..neural.sources")


def implementation(source: str) -> Implementation:
    """The module that implements a source of SOURCES."""
    return cast(Implementation, import_module(SOURCES[source].implementation, __package__))


def kernels_of(bundle: str) -> GuideKernels:
    """How lanes are sampled, by the name of their bundle's class.

    Raises
    ------
    LookupError
        If no source has such lanes.
    """
    # Networks last, which are loaded for no other lanes than their own.
    for source in sorted(SOURCES, key=lambda name: SOURCES[name].is_network):
        for kind, kernels in implementation(source).KERNELS.items():
            if kind.__name__ == bundle:
                return kernels
    raise LookupError(f"no source of directions has lanes of the kind {bundle}: add it to its module's KERNELS")


def make_source_model(settings: RenderSettings) -> SourceModel | None:
    """What learns the source of directions that the settings ask for; None: the mixture field, fitted anyway, is it."""
    return implementation(settings.source).make_model(settings)
