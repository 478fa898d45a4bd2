# SPDX-License-Identifier: GPL-3.0-or-later
"""Curves and spheres: what the rows of a mesh are where they are no triangles."""

from __future__ import annotations

from dataclasses import dataclass

from engine.array_types import Float32Array

RIBBONS, ROUND, ROUND_LINEAR, SPHERES = "RIBBONS", "ROUND", "ROUND_LINEAR", "SPHERES"


@dataclass
class Rounds:
    """Curves or spheres, whose vertices have radii.

    A row of `Mesh.triangles` is a segment of a curve: the vertices that it goes between, and the first of its curve.
    Segments of a curve follow each other. A row of spheres is the centre, three times. Attributes of the domain FACE
    have a value for each row, those of POINT one for each vertex.

    Attributes
    ----------
    shape : str
        'RIBBONS', Catmull-Rom splines that are flat and face the ray; 'ROUND', such splines that are round;
        'ROUND_LINEAR', straight and round segments; or 'SPHERES'.
    radii : float32 (V,)
        Of the vertices, in object space.
    subdivisions : int
        Ribbons are followed in so many straight pieces a segment, and one more.
    motion_radii : float32 (S, V) or None
        Radii at the times of `Mesh.motion_vertices`; None: always the same.
    """

    shape: str
    radii: Float32Array
    subdivisions: int = 2
    motion_radii: Float32Array | None = None
