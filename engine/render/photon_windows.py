# SPDX-License-Identifier: GPL-3.0-or-later
"""How near in time and wavelength photons must be to a path that gathers them, and how fast that shrinks.

A disc and windows are a kernel of d dimensions: two of the disc, one of each window. Its widths go with the number of
photons n to the power of -1 / (d + 4). Then the square of the bias, which goes with the fourth power of the widths, and
the variance, with one over n times their product, both go with n^(-4 / (d + 4)): the picture converges.

References: Knaus and Zwicker 2011, "Progressive Photon Mapping: A Probabilistic Approach", section 4: d = 2, and
alpha = 2/3; Silverman 1986, "Density Estimation for Statistics and Data Analysis", section 4.3.
"""

from __future__ import annotations

from dataclasses import dataclass

#: The first window of time, over the shutter; wider where nothing goes further in it than these radii.
_FIRST_TIME, _RADII = 0.5, 4.0
#: And of wavelengths, over those between two of a path.
_FIRST_WAVES = 0.5
#: A path has four wavelengths: the window of each is so much of [0, 1).
_BETWEEN_WAVES = 0.25


@dataclass(frozen=True)
class Windows:
    """Which windows there are.

    motion : float, how far things go while the shutter is open [m]; 0: nothing moves
    is_spectral : bool, whether paths have wavelengths
    """

    motion: float = 0.0
    is_spectral: bool = False

    @property
    def exponent(self) -> float:
        """Widths go with the number of photons to the power of this."""
        return -1.0 / (6 + (self.motion > 0.0) + self.is_spectral)

    def first_radius(self, radius: float) -> float:
        """Radius of the disc that has as many photons of the first windows as that of `radius` has in all [m]."""
        if self.is_spectral:
            radius *= _FIRST_WAVES**-0.5
        if self.motion > _RADII * radius:
            # r^2 times the window is the square of `radius`, while the window is as many radii.
            longer = (radius * radius * self.motion / _RADII) ** (1.0 / 3.0)
            radius = min(longer, radius * _FIRST_TIME**-0.5)
        return radius

    def half_time(self, first_radius: float, shrunk: float) -> float:
        """Half of the window of time; 0: all photons count.

        Parameters
        ----------
        first_radius : float [m]
        shrunk : float
            What has become of the radius since, over it.
        """
        if not self.motion > 0.0:
            return 0.0
        return 0.5 * min(max(_FIRST_TIME, _RADII * first_radius / self.motion) * shrunk, 1.0)

    def half_waves(self, shrunk: float) -> float:
        """Half of the window of wavelengths, in [0, 1), by which they are drawn; 0: there are none."""
        return 0.5 * _BETWEEN_WAVES * _FIRST_WAVES * shrunk if self.is_spectral else 0.0


def share_of_photons(half_time: float, half_waves: float) -> float:
    """Which share of all photons is in the windows."""
    return (2.0 * half_time or 1.0) * (2.0 * half_waves / _BETWEEN_WAVES or 1.0)
