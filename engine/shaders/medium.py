# SPDX-License-Identifier: GPL-3.0-or-later
"""A medium that is the same everywhere, as numbers."""

from __future__ import annotations

from dataclasses import dataclass

Triple = tuple[float, float, float]
BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PhaseLobe:
    """A part of what a medium scatters, by Draine's phase function of mean cosine `g` and `alpha`.

    scattering : tuple of 3 floats [m^-1]; alpha 0 is Henyey and Greenstein's function, g 0 and alpha 1 Rayleigh's
    """

    scattering: Triple
    g: float = 0.0
    alpha: float = 0.0


@dataclass(frozen=True)
class Medium:
    """A medium that is the same everywhere.

    absorption : tuple of 3 floats [m^-1]; emission : tuple of 3 floats, radiance a metre
    """

    absorption: Triple = BLACK
    emission: Triple = BLACK
    lobes: tuple[PhaseLobe, ...] = ()

    @property
    def is_empty(self) -> bool:
        """Whether rays do not notice it."""
        return not any(self.absorption) and not any(self.emission) and not self.lobes
