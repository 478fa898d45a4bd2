# SPDX-License-Identifier: GPL-3.0-or-later
"""Powers fitted to costs: straight lines between logarithms."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np

#: What `scaling` writes, and `report` draws.
SCALING_FILE = "scaling.json"


@dataclass(frozen=True)
class PowerFit:
    """y = factor x^exponent, by least squares of logarithms.

    standard_error : of the exponent, from how far the points are off the line; nan of two points
    """

    factor: float
    exponent: float
    standard_error: float

    def predict(self, x: float) -> float:
        """y at x."""
        return self.factor * x**self.exponent

    def __str__(self) -> str:
        error = "" if math.isnan(self.standard_error) else f" ± {self.standard_error:.2f}"
        return f"exponent {self.exponent:.2f}{error}"


def fit_power(xs: Sequence[float], ys: Sequence[float]) -> PowerFit:
    """Fit a power to positive figures.

    Raises
    ------
    ValueError
        For less than two different x, or figures that have no logarithm.
    """
    x, y = np.asarray(xs, np.float64), np.asarray(ys, np.float64)
    if x.shape != y.shape or len(np.unique(x)) < 2:
        raise ValueError("a power needs two different x at least")
    if not (np.isfinite(x).all() and np.isfinite(y).all() and (x > 0.0).all() and (y > 0.0).all()):
        raise ValueError("a power is fitted to positive finite figures only")
    u, v = np.log(x), np.log(y)
    du = u - u.mean()
    spread = float((du**2).sum())
    exponent = float((du * v).sum()) / spread
    rest = v - v.mean() - exponent * du
    error = math.sqrt(float((rest**2).sum()) / (len(x) - 2) / spread) if len(x) > 2 else math.nan
    return PowerFit(math.exp(float(v.mean()) - exponent * float(u.mean())), exponent, error)


@dataclass(frozen=True)
class Curve:
    """What was measured of one dependence.

    name : what cost depends on; rival : whose
    x, y : axes with their units
    """

    name: str
    rival: str
    x: str
    y: str
    xs: list[float]
    ys: list[float]

    @property
    def fit(self) -> PowerFit:
        """The power that fits."""
        return fit_power(self.xs, self.ys)

    def stored(self) -> dict[str, Any]:
        """For JSON, with the fit."""
        return {**asdict(self), **asdict(self.fit)}


def curves_of(stored: Mapping[str, Any]) -> list[Curve]:
    """Curves out of the JSON that `scaling` wrote."""
    names = Curve.__dataclass_fields__
    return [Curve(**{name: one[name] for name in names}) for one in stored["curves"]]
