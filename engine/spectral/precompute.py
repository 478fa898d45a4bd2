# SPDX-License-Identifier: GPL-3.0-or-later
"""Compute the file of coefficients: `python -m engine.spectral.precompute` (a few seconds).

At each node of the table the three coefficients are fitted by Gauss and Newton's method, damped (Levenberg 1944), to
the node's colour in CIELAB (Jakob and Hanika 2019), starting from those of the node before it along the axis of the
largest channel. Every node's colour is reached: Delta E is below 1e-4.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from engine.spectral.observer import GRID, RESPONSES, XYZ_TO_REC709
from engine.spectral.tables import COEFFICIENTS_FILE
from engine.spectral.upsampling import LEAST_VALUE, MIDDLE, RATIO_COUNT, TABLE_SHAPE, UNIT, VALUE_COUNT

FloatArray = npt.NDArray[np.float64]

#: Where q of the last node stands for 1: white has no finite coefficients.
LARGEST_Q = 0.999
STEPS = 60
#: Squared Delta E at which a node is done.
ENOUGH = 1e-10
#: Nodes fitted at once.
CHUNK = 2000

_REC709_TO_XYZ = np.linalg.inv(XYZ_TO_REC709.astype(np.float64))
_WHITE = _REC709_TO_XYZ.sum(axis=1)
_POWERS = np.stack([((GRID - MIDDLE) / UNIT) ** power for power in (2, 1, 0)], axis=1)


def sigmoid(x: FloatArray) -> FloatArray:
    """S(x) of `engine.spectral.upsampling`."""
    return 0.5 + 0.5 * x / np.sqrt(1.0 + x * x)


def _lab(rgb: FloatArray) -> tuple[FloatArray, FloatArray]:
    """CIELAB of linear Rec.709 (N, 3) and its derivatives (N, 3 of CIELAB, 3 of Rec.709)."""
    relative = rgb @ _REC709_TO_XYZ.T / _WHITE
    bend = 6.0 / 29.0
    root = np.cbrt(np.maximum(relative, bend**3))
    is_linear = relative <= bend**3
    f = np.where(is_linear, relative / (3.0 * bend**2) + 4.0 / 29.0, root)
    slope = np.where(is_linear, 1.0 / (3.0 * bend**2), 1.0 / (3.0 * root**2))
    mix = np.array(((0.0, 116.0, 0.0), (500.0, -500.0, 0.0), (0.0, 200.0, -200.0)))
    return f @ mix.T - np.array((16.0, 0.0, 0.0)), (mix * slope[:, None, :]) @ (_REC709_TO_XYZ / _WHITE[:, None])


def _residuals(coefficients: FloatArray, target: FloatArray) -> tuple[FloatArray, FloatArray]:
    """CIELAB minus the target's (N, 3), and its derivatives by the coefficients (N, 3, 3)."""
    x = coefficients @ _POWERS.T
    lab, by_rgb = _lab(sigmoid(x) @ RESPONSES)
    slope = 0.5 * (1.0 + x * x) ** -1.5
    by_coefficient = np.stack([(slope * _POWERS[:, k]) @ RESPONSES for k in range(3)], axis=2)
    return lab - target, by_rgb @ by_coefficient


def fit(rgb: FloatArray, start: FloatArray) -> FloatArray:
    """Coefficients whose spectra have these colours.

    Parameters
    ----------
    rgb : float64 (N, 3)
        Linear Rec.709, 0 to 1, less than 1 in some channel.
    start : float64 (N, 3)
        Coefficients of colours nearby.

    Returns
    -------
    float64 (N, 3), c0 c1 c2
    """
    found = []
    for first in range(0, len(rgb), CHUNK):
        c = start[first : first + CHUNK]
        target = _lab(rgb[first : first + CHUNK])[0]
        damping = np.full(len(c), 1e-2)
        residual, jacobian = _residuals(c, target)
        for _ in range(STEPS):
            error = (residual**2).sum(axis=1)
            if error.max() < ENOUGH:
                break
            normal = np.swapaxes(jacobian, 1, 2) @ jacobian
            diagonal = np.einsum("nii->ni", normal)
            damped = diagonal * damping[:, None] + 1e-9 * diagonal.sum(axis=1, keepdims=True)
            gradient = np.einsum("nij,ni->nj", jacobian, residual)
            step = np.linalg.solve(normal + damped[:, :, None] * np.eye(3), gradient[..., None])[..., 0]
            tried, tried_jacobian = _residuals(c - step, target)
            better = (tried**2).sum(axis=1) < error
            c = np.where(better[:, None], c - step, c)
            residual = np.where(better[:, None], tried, residual)
            jacobian = np.where(better[:, None, None], tried_jacobian, jacobian)
            damping = np.clip(np.where(better, 0.2 * damping, 4.0 * damping), 1e-12, 1e8)
        found.append(c)
    return np.concatenate(found)


def _nodes() -> tuple[FloatArray, FloatArray]:
    """Largest channel and ratio at the nodes of their axes."""
    first = (2.0 * LEAST_VALUE - 1.0) / (1.0 + 2.0 * np.sqrt(LEAST_VALUE * (1.0 - LEAST_VALUE)))
    q = np.minimum(np.linspace(first, 1.0, VALUE_COUNT), LARGEST_Q)
    axis = np.linspace(0.0, 1.0, RATIO_COUNT)
    return sigmoid(2.0 * q / (1.0 - q * q)), np.where(axis < 0.5, 2.0 * axis**2, 1.0 - 2.0 * (1.0 - axis) ** 2)


def compute_table() -> npt.NDArray[np.float32]:
    """The table of `engine.spectral.upsampling`, float32 `TABLE_SHAPE`."""
    values, ratios = _nodes()
    second, first = (grid.ravel() for grid in np.meshgrid(ratios, ratios, indexing="ij"))
    table = np.zeros(TABLE_SHAPE)
    for channel in range(3):
        chroma = np.ones((len(first), 3))
        chroma[:, (channel + 1) % 3] = first
        chroma[:, (channel + 2) % 3] = second
        c = np.zeros((len(first), 3))
        for saturation in np.linspace(0.0, 1.0, 6):
            c = fit(values[0] * (saturation * chroma + 1.0 - saturation), c)
        for node, value in enumerate(values):
            c = fit(value * chroma, c)
            x = np.stack([c[:, 0] - c[:, 1] + c[:, 2], c[:, 2], c.sum(axis=1)], axis=1)
            table[channel, node] = (x / (1.0 + np.sqrt(1.0 + x * x))).reshape(RATIO_COUNT, RATIO_COUNT, 3)
    return table.astype(np.float32)


def main() -> None:
    """Write the file anew."""
    np.savez_compressed(COEFFICIENTS_FILE, coefficients=compute_table())


if __name__ == "__main__":
    main()
