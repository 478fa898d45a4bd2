# SPDX-License-Identifier: GPL-3.0-or-later
"""What a scene is for LuxCore: properties by their names, meshes and pictures.

LuxCore's properties: https://wiki.luxcorerender.org/LuxCore_SDL_Reference_Manual_v2.5
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, field
from typing import Any

import numpy as np

Properties = dict[str, Any]
#: Points, triangles and normals.
Mesh = tuple[np.ndarray, np.ndarray, np.ndarray]


@dataclass(frozen=True)
class LuxScene:
    """A scene for `benchmarks.luxcore.process`.

    Attributes
    ----------
    properties : dict
        Of the scene and the film, by LuxCore's names.
    meshes : dict of str to (points, triangles, normals)
        float64 (V, 3) [m], int64 (T, 3), float64 (V, 3); three vertices a triangle.
    footprint : float
        Width of a pixel on what is seen in the middle of the picture [m].
    images : dict of str to float32 (height, width, 3)
        Linear, row 0 at the top.
    """

    properties: Properties
    meshes: dict[str, Mesh]
    footprint: float = 0.0
    images: dict[str, np.ndarray] = field(default_factory=dict)


def prefixed(prefix: str, properties: Properties) -> Properties:
    """The same with `prefix` and a dot before each name."""
    return {f"{prefix}.{name}": value for name, value in properties.items()}


def socket_value(node: Any, name: str) -> Any:
    """What a node's input is: a float, or a tuple of float.

    Raises
    ------
    ValueError
        If it is linked.
    """
    socket = node.inputs[name]
    if socket.is_linked:
        raise ValueError(f"its input {name} is linked")
    value = socket.default_value
    return float(value) if isinstance(value, float) else tuple(float(v) for v in value)


def refuse_links(node: Any, known: Collection[str] = ()) -> None:
    """Raise ValueError for a linked input that is none of `known`."""
    for socket in node.inputs:
        if socket.is_linked and socket.name not in known:
            raise ValueError(f"its input {socket.name} is linked")
