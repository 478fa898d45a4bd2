# SPDX-License-Identifier: GPL-3.0-or-later
"""Light portals as kernels read them, built by `engine.builder.portals`: openings for the background's light."""

import numpy as np

from engine.array_types import Int64Array

# Columns of LightArrays.portals (float32)
PORTAL_P = 0  # centre [m]
PORTAL_AXIS_U = 3  # unit
PORTAL_AXIS_V = 6
#: Unit normal, to the side that light comes out at.
PORTAL_DIRECTION = 9
PORTAL_LENGTH_U = 12  # [m]
PORTAL_LENGTH_V = 13
PORTAL_IS_ROUND = 14  # 1: the ellipse within the rectangle
#: Probability of drawing a direction through portals, where there is one to draw through; the same in all rows.
PORTAL_SHARE = 15
PORTAL_WIDTH = 16

# LightArrays.portal_kernels
#: Addresses of kernels (`engine.kernels.lights.portals`).
PORTAL_SAMPLE = 0
PORTAL_PDF = 1
PORTAL_KERNELS = 2


def no_portal_kernels() -> Int64Array:
    """Where there are no portals, nothing is compiled for them."""
    return np.zeros(PORTAL_KERNELS, np.int64)
