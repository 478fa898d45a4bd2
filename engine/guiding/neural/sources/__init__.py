# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks as sources of directions."""

from __future__ import annotations

from typing import Protocol, cast

from engine.guiding.neural.models.network_source import NetworkDesign
from engine.guiding.sources import implementation
from engine.guiding.sources.guide_kernels import Implementation
from engine.methods import SOURCES
from engine.settings import RenderSettings


class NetworkImplementation(Implementation, Protocol):
    """A module of this package that `engine.methods.SOURCES` names."""

    def design(self, settings: RenderSettings) -> NetworkDesign:
        """Shape and training."""


def network_design(settings: RenderSettings) -> NetworkDesign:
    """Shape and training of the network that `settings.source` names.

    Raises
    ------
    ValueError
        If it names none.
    """
    if not SOURCES[settings.source].is_network:
        raise ValueError(f"source {settings.source!r} is no network")
    return cast(NetworkImplementation, implementation(settings.source)).design(settings)
