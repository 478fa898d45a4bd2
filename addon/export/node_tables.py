# SPDX-License-Identifier: GPL-3.0-or-later
"""Colour ramps and curves as tables, sampled where Cycles samples them."""

from __future__ import annotations

from typing import Any

import bpy
import numpy as np

from engine.array_types import Float32Array

#: Entries of a table: Cycles 5.0 samples 256 intervals, both ends included.
TABLE_SIZE = 257


def bake_ramp(ramp: bpy.types.ColorRamp) -> Float32Array:
    """Colour and alpha over [0, 1], float32 (257, 4)."""
    return np.array([tuple(ramp.evaluate(i / (TABLE_SIZE - 1))) for i in range(TABLE_SIZE)], np.float32)


def bake_curves(mapping: bpy.types.CurveMapping, kind: str) -> dict[str, Any]:
    """Properties of a curves node.

    Returns
    -------
    dict
        `curves` float32 (257, 3), or (257, 1) for a float curve, over [`min_x`, `max_x`], which spans every curve;
        `extrapolate` whether the curves go on outside. For RGB curves the combined curve is applied first.
    """
    mapping.initialize()
    channel_count = {"ShaderNodeRGBCurve": 4, "ShaderNodeVectorCurve": 3, "ShaderNodeFloatCurve": 1}[kind]
    curves = [mapping.curves[i] for i in range(channel_count)]
    min_x = min(curve.points[0].location[0] for curve in curves)
    max_x = max(curve.points[-1].location[0] for curve in curves)
    positions = [min_x + i / (TABLE_SIZE - 1) * (max_x - min_x) for i in range(TABLE_SIZE)]
    if kind == "ShaderNodeRGBCurve":
        combined = curves.pop()
        positions = [mapping.evaluate(combined, x) for x in positions]
    columns = [[mapping.evaluate(curve, x) for x in positions] for curve in curves]
    return {
        "curves": np.array(columns, np.float32).T.copy(),
        "min_x": float(min_x),
        "max_x": float(max_x),
        "extrapolate": mapping.extend == "EXTRAPOLATED",
    }


def bake_constant(mapping: bpy.types.CurveMapping, value: float) -> Float32Array:
    """A float curve that is the same everywhere, float32 (257, 1): what Blender makes of a value that is not linked.

    Blender inlines such nodes before Cycles sees them. It clips what comes out, which Cycles does not.
    """
    result = mapping.evaluate(mapping.curves[0], value)
    if mapping.use_clip:
        result = min(max(result, mapping.clip_min_y), mapping.clip_max_y)
    return np.full((TABLE_SIZE, 1), result, np.float32)
