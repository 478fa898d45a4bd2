# SPDX-License-Identifier: GPL-3.0-or-later
"""The sources of directions, a module for each kind, found by `engine.methods.SOURCES`.

A module is imported when a render first uses it. `engine.runtime.sources.source_hash` counts all modules of a package
whose `__init__` calls `import_module`, so kernels compiled for one are compiled anew when it changes.
"""

from __future__ import annotations

from importlib import import_module
from typing import cast

from engine.guiding.models.network_source import NetworkDesign
from engine.guiding.models.source_model import SourceModel
from engine.guiding.sources.face import GuideFace, Implementation
from engine.methods import SOURCES
from engine.settings import RenderSettings


def implementation(source: str) -> Implementation:
    """The module that implements a source of SOURCES."""
    return cast(Implementation, import_module(SOURCES[source].implementation, __package__))


def face_of(bundle: str) -> GuideFace:
    """How lanes are sampled, by the name of their bundle's class.

    Raises
    ------
    LookupError
        If no source has such lanes.
    """
    for source in SOURCES:
        for kind, face in implementation(source).FACES.items():
            if kind.__name__ == bundle:
                return face
    raise LookupError(f"no source of directions has lanes of the kind {bundle}: add it to its module's FACES")


def make_source_model(settings: RenderSettings) -> SourceModel | None:
    """What learns the source of directions that the settings ask for; None: the mixture field, fitted anyway, is it."""
    return implementation(settings.source).make_model(settings)


def network_design(settings: RenderSettings) -> NetworkDesign:
    """Shape and training of the network that `settings.source` names.

    Raises
    ------
    ValueError
        If it names none.
    """
    if not SOURCES[settings.source].is_network:
        raise ValueError(f"source {settings.source!r} is no network")
    return implementation(settings.source).design(settings)
