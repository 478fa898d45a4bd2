# SPDX-License-Identifier: GPL-3.0-or-later
"""Where what is in a thread's scratch lies: Embree's ray, the arguments of searches, and what these keep.

Numbers are in words of four bytes, unless they are said to be in bytes.
"""

from __future__ import annotations

import numpy as np

NONE = np.uint32(0xFFFFFFFF)

# Words of an RTCRayHit that hold the answer; the distance is the ray's length before.
HIT_DISTANCE = 8
HIT_NORMAL = 12  # of the shape, as it lies in the space of its mesh; not unit
HIT_U = 15
HIT_TRIANGLE = 17  # within its mesh
HIT_GEOMETRY = 18
HIT_INSTANCE = 19

# Behind the RTCRayHit in a thread's scratch, in words: the arguments of searches that skip the triangles at their ends,
# of those that count what they pass, and of those for boundaries of media; their context, of which Embree knows the
# first two words; boundaries that were found; and numbers of these in the order of the distance.
SKIPPING_ARGUMENTS = 32
PASSING_ARGUMENTS = 48
BOUNDARY_ARGUMENTS = 64
CONTEXT = 80
CONTEXT_COUNT = CONTEXT + 2
CONTEXT_INSTANCE_COUNT = CONTEXT + 3
CONTEXT_MASKS = CONTEXT + 4  # address
# The triangles that the ray starts and ends on: instance, number within the mesh, and how many from there on (of a
# curve all segments).
CONTEXT_OWN = CONTEXT + 6
CONTEXT_LIGHT = CONTEXT + 9
FIRST_BOUNDARY = CONTEXT + 16
#: Boundaries that a search finds at once.
MOST_BOUNDARIES = 128
# A boundary has distance, u, v, triangle within its mesh, instance, normal, the ray's direction in the same space.
BOUNDARY_WIDTH = 12
BOUNDARY_ORDER = FIRST_BOUNDARY + MOST_BOUNDARIES * BOUNDARY_WIDTH
SCRATCH_WORDS = BOUNDARY_ORDER + MOST_BOUNDARIES
WORD_BYTES = 4
