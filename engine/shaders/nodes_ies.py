# SPDX-License-Identifier: GPL-3.0-or-later
"""Entry of the node table for IES Texture."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.shader.ops_texture import OP_IES
from engine.scene.description import Node
from engine.shaders.photometry import PhotometryError, read_photometry
from engine.shaders.table import FLOAT, VECTOR, Implicit, NodeTable, Operation, Socket

#: What Cycles takes for the intensity where there is no file.
_WITHOUT_FILE = 100.0
_FAC = Socket("Fac", FLOAT)


def _ies(node: Node, builder: Any) -> Operation:
    """The text is the property `photometry`, '' = there is none."""
    strength = Socket("Strength", FLOAT, 1.0)
    inputs = (Socket("Vector", VECTOR, Implicit.LOCAL_INCOMING), strength)
    try:
        table = read_photometry(str(node.properties.get("photometry", "")))
    except PhotometryError as error:
        builder.notice(str(error), "100 in every direction, as in Cycles")
        # Two lines of two angles, all the same.
        table = np.array([2.0, 2.0, 0.0, 7.0, -1.0, 4.0, *[_WITHOUT_FILE] * 4], np.float32)
    return Operation(OP_IES, inputs, (_FAC,), (builder.add_table(table),))


NODES: NodeTable = {"ShaderNodeTexIES": _ies}
