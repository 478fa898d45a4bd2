# SPDX-License-Identifier: GPL-3.0-or-later
"""float32 constants for kernels (a global float would be float64; a literal inside a kernel is float32 already)."""

import numpy as np

PI = np.float32(np.pi)
TWO_PI = np.float32(2.0 * np.pi)
HALF_PI = np.float32(0.5 * np.pi)
INV_PI = np.float32(1.0 / np.pi)
INV_TWO_PI = np.float32(0.5 / np.pi)
FOUR_PI = np.float32(4.0 * np.pi)
INV_FOUR_PI = np.float32(0.25 / np.pi)
INFINITY = np.float32(np.inf)
NAN = np.float32(np.nan)
#: Distance to everything at infinity, and from which on a distance is taken for that [m].
DISTANT = np.float32(1e30)
FAR = np.float32(1e29)
FLOAT_MAX = np.float32(3.4e38)
#: The inverse of what is smaller may be infinite.
FLOAT_MIN = np.float32(1.2e-38)
ONE_MINUS_EPSILON = np.float32(1.0 - 2.0**-24)

#: Rec.709 luminance weights, from the primaries and D65 as Blender's colour configuration has them.
LUMINANCE_R = np.float32(0.2126390)
LUMINANCE_G = np.float32(0.7151687)
LUMINANCE_B = np.float32(0.0721923)
