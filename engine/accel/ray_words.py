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
# of those that keep what they pass, and of those for boundaries of media; their context, of which Embree knows the
# first two words; hits that were kept; and numbers of these in the order of the distance.
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
#: How many hits a shadow ray may pass.
CONTEXT_MOST = CONTEXT + 12
FIRST_KEPT = CONTEXT + 16
#: Boundaries that a search finds at once.
MOST_BOUNDARIES = 128
#: Hits that a shadow ray passes of which a search keeps where they are: the closest.
MOST_PASSED = 32
# A hit has distance, u, v, triangle within its mesh, instance, and a boundary its normal and the ray's direction in the
# same space as well.
KEPT_WIDTH = 12
KEPT_ORDER = FIRST_KEPT + MOST_BOUNDARIES * KEPT_WIDTH
SCRATCH_WORDS = KEPT_ORDER + MOST_BOUNDARIES
WORD_BYTES = 4
