# SPDX-License-Identifier: GPL-3.0-or-later
"""What the program of a lamp may ask of the lamp: where it is, and what its object says of itself."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from engine.scene.description import Light, NodeGraph

_Vector = tuple[float, float, float]

#: Nodes that read the lamp; textures besides, which look at its own space where nothing is linked.
_READERS = ("ShaderNodeTexCoord", "ShaderNodeObjectInfo", "ShaderNodeVectorTransform")
_TEXTURE = "ShaderNodeTex"


@dataclass(frozen=True)
class LampFacts:
    """One lamp.

    Attributes
    ----------
    axes : tuple of 3 tuples of 3 floats
        Its axes in the world, scaled as it is: as rows they are the matrix of normals from the world to its own space.
    location : tuple of 3 floats
        World [m].
    middle, reach : tuple of 3 floats, and of 3 such tuples
        Points of it, as its program sees them, are about `middle` + `reach` times unit vectors.
    color : tuple of 4 floats
        Of the object, linear, with alpha.
    pass_index : int
    random : float
        In [0, 1).
    """

    axes: tuple[_Vector, _Vector, _Vector]
    location: _Vector
    middle: _Vector
    reach: tuple[_Vector, _Vector, _Vector]
    color: tuple[float, float, float, float]
    pass_index: int
    random: float

    @property
    def to_world(self) -> np.ndarray:
        """Its own space to the world, float64 (3, 4)."""
        return np.column_stack([np.transpose(self.axes), self.location])

    @property
    def to_local(self) -> np.ndarray:
        """The world to its own space, float64 (3, 4)."""
        inverse = np.linalg.pinv(np.transpose(self.axes))
        return np.column_stack([inverse, -inverse @ np.array(self.location)])


def facts_of(light: Light, graph: NodeGraph) -> LampFacts | None:
    """Facts of a lamp whose graph reads any, so that the graphs of others are compiled once for all places."""
    if not any(node.kind in _READERS or node.kind.startswith(_TEXTURE) for node in graph.nodes):
        return None
    matrix = np.asarray(light.transform, np.float64)
    if not np.isfinite(matrix).all():
        return None
    axes, middle = matrix[:3, :3].T, matrix[:3, 3]
    reach = light.radius * np.eye(3)
    if light.kind == "AREA":
        size_y = light.size_x if light.shape in ("SQUARE", "DISK") else light.size_y
        reach = np.array([0.5 * light.size_x, 0.5 * size_y, 0.0])[:, None] * axes
    elif light.kind == "SUN":
        middle, reach = -axes[2] / max(float(np.linalg.norm(axes[2])), 1e-30), np.sin(0.5 * light.angle) * np.eye(3)
    red, green, blue, alpha = (float(x) for x in light.object_color)
    return LampFacts(
        _triples(axes), _triple(matrix[:3, 3]), _triple(middle), _triples(reach), (red, green, blue, alpha),
        light.pass_index, light.random,
    )  # fmt: skip


def _triple(values: np.ndarray) -> _Vector:
    x, y, z = values.tolist()
    return x, y, z


def _triples(rows: np.ndarray) -> tuple[_Vector, _Vector, _Vector]:
    first, second, third = (_triple(row) for row in rows)
    return first, second, third
