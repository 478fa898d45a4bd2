# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread's memory for rays."""

from __future__ import annotations

import numpy as np

from engine.accel.called import address_of
from engine.accel.filters import keep_boundary, keep_passed, skip
from engine.accel.ray_words import (
    BOUNDARY_ARGUMENTS,
    CONTEXT,
    CONTEXT_LIGHT,
    CONTEXT_OWN,
    NONE,
    PASSING_ARGUMENTS,
    SCRATCH_WORDS,
    SKIPPING_ARGUMENTS,
    WORD_BYTES,
)

_EVERY_FEATURE = np.uint32(0xFFFFFFFF)


class RayScratch:
    """One thread's aligned RTCRayHit, and what searches that do not end at a hit have besides."""

    def __init__(self) -> None:
        raw = np.zeros(SCRATCH_WORDS + 16, np.float32)
        start = (-raw.ctypes.data % 64) // 4
        self.ray = raw[start : start + SCRATCH_WORDS]
        self.bits = self.ray.view(np.uint32)
        self.address = self.ray.ctypes.data
        for first, function in (
            (SKIPPING_ARGUMENTS, skip), (PASSING_ARGUMENTS, keep_passed), (BOUNDARY_ARGUMENTS, keep_boundary)
        ):
            # RTCIntersectArguments, or RTCOccludedArguments: flags, features, context, filter function, and nothing of
            # what is no triangle.
            called = self.address + CONTEXT * WORD_BYTES, address_of(function)
            self.bits[first + 1] = _EVERY_FEATURE
            self.bits[first + 2 : first + 6].view(np.int64)[:] = called
        self.bits[CONTEXT : CONTEXT + 2] = NONE
        self.bits[CONTEXT_OWN : CONTEXT_LIGHT + 3] = NONE
