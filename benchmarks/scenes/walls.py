# SPDX-License-Identifier: GPL-3.0-or-later
"""Walls of rooms whose lamps are out of sight."""

from __future__ import annotations

from collections.abc import Sequence

from benchmarks.scenes.studio import add_object, mesh


def wall_with_hole(name: str, surface: object, y: float, hole: Sequence[float], half: float, top: float) -> None:
    """A wall across y, from -half to half and 0 to `top`, with a hole (x0, x1, z0, z1)."""
    x0, x1, z0, z1 = hole
    xs, zs = (-half, x0, x1, half), (0.0, z0, z1, top)
    vertices = [(x, y, z) for z in zs for x in xs]
    faces = [
        (4 * row + column, 4 * row + column + 1, 4 * row + column + 5, 4 * row + column + 4)
        for row in range(3)
        for column in range(3)
        if (row, column) != (1, 1)
    ]
    add_object(name, mesh(name, vertices, faces, surface))


def shell(name: str, surface: object, low: Sequence[float], high: Sequence[float], open_sides: str = "") -> None:
    """The inside of a box but for the sides named: x, X, y, Y, z, Z (small: low)."""
    corners = [(x, y, z) for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])]
    sides = {
        "x": (0, 1, 3, 2), "X": (4, 6, 7, 5), "y": (0, 4, 5, 1),
        "Y": (2, 3, 7, 6), "z": (0, 2, 6, 4), "Z": (1, 5, 7, 3),
    }  # fmt: skip
    add_object(name, mesh(name, corners, [face for side, face in sides.items() if side not in open_sides], surface))
