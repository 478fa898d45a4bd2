# SPDX-License-Identifier: GPL-3.0-or-later
"""What is inside of things: a medium that is the same everywhere as numbers, of another that there is one."""

from __future__ import annotations

from dataclasses import dataclass

Triple = tuple[float, float, float]
BLACK = (0.0, 0.0, 0.0)


@dataclass(frozen=True)
class PhaseLobe:
    """A part of what a medium scatters, by Draine's phase function of mean cosine `g` and `alpha`.

    scattering : tuple of 3 floats [m^-1]; alpha 0 is Henyey and Greenstein's function, g 0 and alpha 1 Rayleigh's
    delta : not 0: the function is Fournier and Forand's of this mean cosine, and `alpha` its exponent
    """

    scattering: Triple
    g: float = 0.0
    alpha: float = 0.0
    delta: float = 0.0


@dataclass(frozen=True)
class Medium:
    """A medium.

    absorption : tuple of 3 floats [m^-1]; emission : tuple of 3 floats, radiance a metre
    varies : bool, whether it differs from place to place: the program says how, and these numbers are 0
    """

    absorption: Triple = BLACK
    emission: Triple = BLACK
    lobes: tuple[PhaseLobe, ...] = ()
    varies: bool = False

    @property
    def is_empty(self) -> bool:
        """Whether rays do not notice it."""
        return not (self.varies or any(self.absorption) or any(self.emission) or self.lobes)
