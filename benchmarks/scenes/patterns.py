# SPDX-License-Identifier: GPL-3.0-or-later
"""Patterns that few scenes have, whose kernel is linked: Gabor Texture and Radial Tiling."""

from __future__ import annotations

from typing import Any

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, Surface
from benchmarks.scenes.textures import boards


def _gabor_board(output: str, kind: str, **inputs: Any) -> Surface:
    def surface(nodes: Nodes) -> Socket:
        vector = nodes("TexCoord", output="Generated")
        value = nodes("TexGabor", {"gabor_type": kind}, output=output, Vector=vector, **inputs)
        return nodes("BsdfDiffuse", Color=value)

    return surface


def _tiled_board(output: str, sides: float, roundness: float, normalize: bool) -> Surface:
    """Colours, or a checker, in the segments of a polygon."""

    def surface(nodes: Nodes) -> Socket:
        vector = nodes("Mapping", Vector=nodes("TexCoord", output="UV"), Location=(-1.5, -1.5, 0.0), Scale=(3, 3, 3))
        properties = {"normalize": normalize}
        inputs = {"Sides": sides, "Roundness": roundness}
        value = nodes("RadialTiling", properties, output=output, Vector=vector, **inputs)
        if output == "Segment Coordinates":
            value = nodes("TexChecker", Vector=value, Scale=4.0, Color1=(0.9, 0.4, 0.1), Color2=(0.1, 0.3, 0.8))
        elif output == "Segment ID":
            value = nodes("TexWhiteNoise", {"noise_dimensions": "1D"}, output="Color", W=value)
        elif output == "Segment Rotation":
            value = nodes("Math", {"operation": "MULTIPLY"}, {0: value, 1: 0.15})
        return nodes("BsdfDiffuse", Color=value)

    return surface


@scene("procedural-patterns")
def procedural_patterns() -> None:
    """Gabor noise in the plane and in space, and polygons tiled radially."""
    boards(
        [
            _gabor_board("Value", "2D", Scale=5.0),
            _gabor_board("Phase", "2D", Scale=3.0, Anisotropy=0.4),
            _gabor_board("Value", "3D", Scale=4.0, Anisotropy=0.0, Frequency=1.5),
            _gabor_board("Intensity", "3D", Scale=4.0, Anisotropy=0.7),
            _tiled_board("Segment Coordinates", 5.0, 0.0, False),
            _tiled_board("Segment Coordinates", 5.4, 0.5, True),
            _tiled_board("Segment ID", 7.5, 0.0, False),
            _tiled_board("Segment Rotation", 6.0, 1.0, False),
        ]
    )
