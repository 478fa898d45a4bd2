# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric files of luminaires (ANSI/IES LM-63, 2002) as tables for kernels, read as forgivingly as by Cycles."""

from __future__ import annotations

import math
import re

import numpy as np

from engine.array_types import Float32Array, FloatArray

#: Candela to the watts of a lamp that shines evenly: 4 pi over the luminous efficacy of D65, 177.83 lm/W.
_WATTS = 0.0706650768394
_NUMBER = re.compile(r"\s*([-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?)")
_INTEGER = re.compile(r"\s*([-+]?\d+)")
_TYPE_C, _TYPE_B, _TYPE_A = 1, 2, 3
#: Angles that are one [deg].
_CLOSE = 1e-4
#: More angles than any luminaire is measured at.
_MOST_ANGLES = 100_000


class PhotometryError(ValueError):
    """A text is no photometric file, or ends too early."""


class _Reader:
    def __init__(self, text: str) -> None:
        text = text.replace(",", " ")
        begin = text.find("\nTILT=")
        if begin < 0:
            raise PhotometryError("photometric data has no line that begins with TILT=")
        self._text, self._place = text, begin

    def skip_tilt(self) -> None:
        """Go behind the line, or behind the table that it announces."""
        if self._text.startswith("\nTILT=INCLUDE", self._place):
            self._place += len("\nTILT=INCLUDE")
            self.number()
            for _ in range(2 * self.integer()):
                self.number()
        else:
            end = self._text.find("\n", self._place + 1)
            if end < 0:
                raise PhotometryError("photometric data ends with its line TILT=")
            self._place = end + 1

    def _read(self, pattern: re.Pattern[str]) -> str:
        found = pattern.match(self._text, self._place)
        if found is None:
            near = " ".join(self._text[self._place : self._place + 30].split())
            missing = f"lacks a number before {near!r}" if near else "ends too early"
            raise PhotometryError(f"photometric data {missing}")
        self._place = found.end()
        return found[1]

    def number(self) -> float:
        return float(self._read(_NUMBER))

    def integer(self) -> int:
        return int(self._read(_INTEGER))

    def numbers(self, count: int) -> FloatArray:
        return np.array([self.number() for _ in range(count)], np.float64)


def read_photometry(text: str) -> Float32Array:
    """The table that `engine.kernels.shader.ies` reads.

    Parameters
    ----------
    text : str

    Returns
    -------
    float32 (N,)
        Angles [rad] of type C, whatever the file's type; intensities as factors on the strength of a lamp.

    Raises
    ------
    PhotometryError
        The text is no photometric file.
    """
    reader = _Reader(text)
    reader.skip_tilt()
    reader.integer()
    reader.number()
    factor = reader.number()
    v_count, h_count, kind = reader.integer(), reader.integer(), reader.integer()
    if kind not in (_TYPE_A, _TYPE_B, _TYPE_C):
        raise PhotometryError(f"photometric data has photometric type {kind}: 1, 2 and 3 are known")
    if not (0 < v_count <= _MOST_ANGLES and 0 < h_count <= _MOST_ANGLES):
        raise PhotometryError(f"photometric data has {v_count} vertical and {h_count} horizontal angles")
    reader.integer()
    reader.numbers(3)
    factor *= reader.number() * reader.number() * _WATTS
    reader.number()
    vertical, horizontal = reader.numbers(v_count), reader.numbers(h_count)
    intensity = factor * reader.numbers(h_count * v_count).reshape(h_count, v_count)
    convert = {_TYPE_A: _from_a, _TYPE_B: _from_b, _TYPE_C: _from_c}[kind]
    horizontal, vertical, intensity = convert(horizontal, vertical, intensity)
    if len(horizontal) < 2 or len(vertical) < 2:
        raise PhotometryError("photometric data has a single angle")
    angles = np.concatenate([horizontal, vertical]) * (math.pi / 180.0)
    return np.concatenate([[len(horizontal), len(vertical)], angles, intensity.ravel()]).astype(np.float32)


_Table = tuple[FloatArray, FloatArray, FloatArray]


def _is(a: float, b: float) -> bool:
    return abs(a - b) < _CLOSE


def _from_a(horizontal: FloatArray, vertical: FloatArray, intensity: FloatArray) -> _Table:
    """Angles from -90 to 90 about the lamp's front, or one half of that."""
    angles, rows = 180.0 - horizontal[::-1], intensity[::-1]
    if _is(horizontal[0], 0.0):
        angles = np.concatenate([angles, 180.0 + horizontal[1:]])
        rows = np.concatenate([rows, intensity[1:]])
    return angles, vertical + 90.0, rows


def _from_b(horizontal: FloatArray, vertical: FloatArray, intensity: FloatArray) -> _Table:
    """The axis lies level: horizontal angles take the place of vertical ones. Lamps are turned by their users."""
    horizontal, vertical, intensity = vertical, horizontal, intensity.T
    if _is(horizontal[0], 0.0):
        horizontal = np.concatenate([90.0 - horizontal[:0:-1], 90.0 + horizontal])
        intensity = np.concatenate([intensity[:0:-1], intensity])
    else:
        horizontal = horizontal + 90.0
    if _is(vertical[0], 0.0):
        vertical = np.concatenate([90.0 - vertical[:0:-1], 90.0 + vertical])
        intensity = np.concatenate([intensity[:, :0:-1], intensity], axis=1)
    else:
        vertical = vertical + 90.0
    return horizontal, vertical, intensity


def _from_c(horizontal: FloatArray, vertical: FloatArray, intensity: FloatArray) -> _Table:
    """Angles all around, or a half or quarter that is mirrored."""
    if _is(horizontal[0], 90.0):
        horizontal = horizontal - 90.0
    if len(horizontal) == 1:
        horizontal, intensity = np.array([0.0, 360.0]), np.concatenate([intensity, intensity])
    for end in (90.0, 180.0):
        if _is(horizontal[-1], end):
            horizontal = np.concatenate([horizontal, 2.0 * end - horizontal[-2::-1]])
            intensity = np.concatenate([intensity, intensity[-2::-1]])
    if _is(horizontal[0], 0.0) and not _is(horizontal[-1], 360.0):
        gap = 360.0 - horizontal[-1]
        if _is(horizontal[-1] - horizontal[-2], gap) or _is(horizontal[1] - horizontal[0], gap):
            horizontal, intensity = np.append(horizontal, 360.0), np.concatenate([intensity, intensity[:1]])
    return horizontal, vertical, intensity
