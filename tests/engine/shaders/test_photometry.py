# SPDX-License-Identifier: GPL-3.0-or-later
"""Photometric files: their types, their tables, what is wrong with broken ones, and the light that kernels find."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.kernels.shader.ies import ies_intensity
from engine.shaders.photometry import PhotometryError, read_photometry

WATTS = 4.0 * math.pi / 177.83


def text(kind: int, horizontal: list[float], vertical: list[float], rows: list[list[float]], tilt: str = "NONE") -> str:
    numbers = "\n".join(" ".join(map(str, line)) for line in (vertical, horizontal, *rows))
    sizes = f"{len(vertical)} {len(horizontal)} {kind} 2 0.1 0.1 0"
    return f"IESNA:LM-63-2002\n[TEST] lamp\nTILT={tilt}\n1 1000, 2.0 {sizes}\n1.0 0.5 60\n{numbers}\n"


def table_of(photometry: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Angles in degrees, and intensities over candela to watts."""
    table = read_photometry(photometry).astype(np.float64)
    h, v = int(table[0]), int(table[1])
    horizontal, vertical = np.degrees(table[2 : 2 + h]), np.degrees(table[2 + h : 2 + h + v])
    return horizontal, vertical, table[2 + h + v :].reshape(h, v) / WATTS


def test_a_quarter_is_mirrored_to_all_sides() -> None:
    found = table_of(text(1, [0.0, 45.0, 90.0], [0.0, 90.0], [[1, 2], [3, 4], [5, 6]]))
    np.testing.assert_allclose(found[0], np.arange(0.0, 361.0, 45.0), atol=1e-4)
    np.testing.assert_allclose(found[2][:, 0], [1, 3, 5, 3, 1, 3, 5, 3, 1], rtol=1e-4)


@pytest.mark.parametrize(("angles", "expected"), [
    ([0.0], [0.0, 360.0]), ([0.0, 180.0], [0.0, 180.0, 360.0]),
    ([90.0, 180.0, 270.0], [0.0, 90.0, 180.0, 270.0, 360.0]),
    ([0.0, 120.0, 240.0], [0.0, 120.0, 240.0, 360.0]), ([0.0, 100.0, 250.0], [0.0, 100.0, 250.0]),
])  # fmt: skip
def test_angles_of_type_c_go_around(angles: list[float], expected: list[float]) -> None:
    found = table_of(text(1, angles, [0.0, 90.0], [[1.0, 1.0]] * len(angles)))
    np.testing.assert_allclose(found[0], expected, atol=1e-4)


def test_types_a_and_b_are_turned_to_type_c() -> None:
    horizontal, vertical, rows = table_of(text(3, [0.0, 90.0], [-90.0, 0.0, 90.0], [[1, 2, 3], [4, 5, 6]]))
    np.testing.assert_allclose(horizontal, [90.0, 180.0, 270.0], atol=1e-4)
    np.testing.assert_allclose(vertical, [0.0, 90.0, 180.0], atol=1e-4)
    np.testing.assert_allclose(rows, [[4, 5, 6], [1, 2, 3], [4, 5, 6]], rtol=1e-4)
    horizontal, vertical, rows = table_of(text(2, [0.0, 90.0], [-90.0, 90.0], [[1, 2], [3, 4]]))
    np.testing.assert_allclose(horizontal, [0.0, 180.0], atol=1e-4)
    np.testing.assert_allclose(vertical, [0.0, 90.0, 180.0], atol=1e-4)
    np.testing.assert_allclose(rows, [[3, 1, 3], [4, 2, 4]], rtol=1e-4)


def test_a_table_of_tilts_is_skipped() -> None:
    plain = text(1, [0.0], [0.0, 90.0], [[1, 2]])
    np.testing.assert_array_equal(
        read_photometry(text(1, [0.0], [0.0, 90.0], [[1, 2]], tilt="INCLUDE\n1 2 0 90 1.0 0.9")), read_photometry(plain)
    )


@pytest.mark.parametrize(("broken", "says"), [
    ("", "TILT"), ("IESNA\nTILT=NONE", "ends"), ("IESNA\nTILT=NONE\n1 1000 2.0 2", "too early"),
    ("IESNA\nTILT=NONE\n1 lumens", "'lumens'"), (text(7, [0.0], [0.0, 90.0], [[1, 2]]), "type 7"),
    (text(1, [0.0], [0.0], [[1]]), "single angle"), (text(1, [], [], []), "0 vertical"),
    (text(1, [0.0], [0.0, 90.0], [[1]]), "too early"),
    ("IESNA\nTILT=NONE\n1 1000 2.0 9999999 9999999 1 2 0 0 0", "9999999 vertical"),
])  # fmt: skip
def test_what_is_wrong_is_said(broken: str, says: str) -> None:
    with pytest.raises(PhotometryError, match=says):
        read_photometry(broken)


def test_kernels_find_the_files_numbers_at_its_angles_and_nothing_beyond() -> None:
    vertical, horizontal = [0.0, 30.0, 60.0, 90.0], [0.0, 90.0, 180.0, 270.0, 360.0]
    rows = np.random.default_rng(1).uniform(1.0, 9.0, (5, 4))
    rows[:, 0], rows[4] = rows[0, 0], rows[0]
    table = read_photometry(text(1, horizontal, vertical, rows.tolist()))
    for i, h in enumerate(np.radians(horizontal[:4])):
        for j, v in enumerate(np.radians(vertical[1:3]), 1):
            # Straight down is 0; h turns from -y towards -x.
            d = (-math.sin(h) * math.sin(v), -math.cos(h) * math.sin(v), -math.cos(v))
            found = ies_intensity(table, 0, tuple(np.float32(3.0 * x) for x in d))
            assert found == pytest.approx(WATTS * rows[i, j], rel=2e-4)
    assert ies_intensity(table, 0, (np.float32(0.1), np.float32(0.0), np.float32(1.0))) == 0.0
