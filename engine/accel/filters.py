# SPDX-License-Identifier: GPL-3.0-or-later
"""What Embree calls back for each hit of some searches: its filter functions.

They pass the triangles that a ray starts and ends on, and keep what shadow rays may pass and boundaries of media.
Embree gets their addresses with the ray (`scratch.py`).
"""

from __future__ import annotations

from engine.accel.masks import MASK_MEDIUM, MASK_SHADOW_TRANSPARENT
from engine.accel.ray_words import (
    CONTEXT,
    CONTEXT_COUNT,
    CONTEXT_INSTANCE_COUNT,
    CONTEXT_LIGHT,
    CONTEXT_MASKS,
    CONTEXT_MOST,
    CONTEXT_OWN,
    FIRST_KEPT,
    KEPT_WIDTH,
    MOST_BOUNDARIES,
    MOST_PASSED,
    WORD_BYTES,
)
from engine.kernels.addresses import read_half, read_real, read_word, write_half
from engine.runtime.jit import kernel

# Bytes of an RTCFilterFunctionNArguments, of the RTCRay and of the RTCHit it points to, and of the context.
_FILTER_VALID, _FILTER_CONTEXT, _FILTER_RAY, _FILTER_HIT = 0, 16, 24, 32
_RAY_DIRECTION, _RAY_END = 16, 32
_FOUND_NORMAL, _FOUND_U, _FOUND_V, _FOUND_TRIANGLE, _FOUND_GEOMETRY, _FOUND_INSTANCE = 0, 12, 16, 20, 24, 28
_FOUND_COUNT = (CONTEXT_COUNT - CONTEXT) * WORD_BYTES
_INSTANCE_COUNT = (CONTEXT_INSTANCE_COUNT - CONTEXT) * WORD_BYTES
_MASKS = (CONTEXT_MASKS - CONTEXT) * WORD_BYTES
_OWN = (CONTEXT_OWN - CONTEXT) * WORD_BYTES
_LIGHT = (CONTEXT_LIGHT - CONTEXT) * WORD_BYTES
_MOST = (CONTEXT_MOST - CONTEXT) * WORD_BYTES
_ROWS = (FIRST_KEPT - CONTEXT) * WORD_BYTES
_ROW_BYTES = KEPT_WIDTH * WORD_BYTES


@kernel
def _filtered_instance(context, hit):
    """Which instance Embree's filter function was called for."""
    instance = read_half(hit, _FOUND_INSTANCE)
    # As in `read_hit`.
    if instance >= read_half(context, _INSTANCE_COUNT):
        instance = read_half(hit, _FOUND_GEOMETRY)
    return instance


@kernel
def _filtered_mask(context, instance):
    """By which rays an instance is found."""
    return read_half(read_word(context, _MASKS), instance * WORD_BYTES)


@kernel
def _is_skipped(context, hit):
    """Whether a hit is on the very triangle or curve that the ray starts on, or on that which it ends on."""
    triangle = read_half(hit, _FOUND_TRIANGLE)
    is_own = 0 <= triangle - read_half(context, _OWN + 4) < read_half(context, _OWN + 8)
    is_light = 0 <= triangle - read_half(context, _LIGHT + 4) < read_half(context, _LIGHT + 8)
    if not (is_own or is_light):
        return False
    instance = _filtered_instance(context, hit)
    return (is_own and instance == read_half(context, _OWN)) or (is_light and instance == read_half(context, _LIGHT))


@kernel(called_by_c=True)
def skip(arguments):
    """Embree's filter function: pass the triangles that the ray starts and ends on.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    if _is_skipped(read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel(called_by_c=True)
def cull(arguments):
    """Embree's filter function: pass what the ray would leave, of what is round.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    ray, hit = read_word(arguments, _FILTER_RAY), read_word(arguments, _FILTER_HIT)
    along = 0.0
    for k in range(3):
        along += read_real(hit, _FOUND_NORMAL + 4 * k) * read_real(ray, _RAY_DIRECTION + 4 * k)
    if along > 0.0:
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel
def _write_hit(row, ray, hit, instance):
    """Write a hit to the row of the scratch at an address."""
    write_half(row, 0, read_half(ray, _RAY_END))
    write_half(row, 4, read_half(hit, _FOUND_U))
    write_half(row, 8, read_half(hit, _FOUND_V))
    write_half(row, 12, read_half(hit, _FOUND_TRIANGLE))
    write_half(row, 16, instance)


@kernel
def _place_of(context, count, distance):
    """Where to write a hit that comes after `count` others, an address; 0: as many that are closer have been kept."""
    first = context + _ROWS
    if count < MOST_PASSED:
        return first + count * _ROW_BYTES
    place, farthest = 0, distance
    for k in range(MOST_PASSED):
        # Bits of floats that are not negative are in the floats' order.
        kept = read_half(first, k * _ROW_BYTES)
        if kept > farthest:
            place, farthest = first + k * _ROW_BYTES, kept
    return place


@kernel(called_by_c=True)
def keep_passed(arguments):
    """Embree's filter function: keep a hit on what shadow rays may pass, and have the search go on.

    A hit more than the ray may pass ends the search, as what is opaque does.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    context, hit = read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)
    if _is_skipped(context, hit):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)
        return
    instance, count = _filtered_instance(context, hit), read_half(context, _FOUND_COUNT)
    if _filtered_mask(context, instance) & MASK_SHADOW_TRANSPARENT == 0 or count >= read_half(context, _MOST):
        return
    ray = read_word(arguments, _FILTER_RAY)
    place = _place_of(context, count, read_half(ray, _RAY_END))
    if place != 0:
        _write_hit(place, ray, hit, instance)
    write_half(context, _FOUND_COUNT, count + 1)
    write_half(read_word(arguments, _FILTER_VALID), 0, 0)


@kernel(called_by_c=True)
def keep_boundary(arguments):
    """Embree's filter function: keep a hit on what has a medium inside, and have the search go on.

    Parameters
    ----------
    arguments : intp
        Address of an RTCFilterFunctionNArguments of one ray.
    """
    context, hit = read_word(arguments, _FILTER_CONTEXT), read_word(arguments, _FILTER_HIT)
    if _is_skipped(context, hit):
        write_half(read_word(arguments, _FILTER_VALID), 0, 0)
        return
    instance = _filtered_instance(context, hit)
    if _filtered_mask(context, instance) & MASK_MEDIUM == 0:
        return
    count = read_half(context, _FOUND_COUNT)
    if count < MOST_BOUNDARIES:
        row = context + _ROWS + count * _ROW_BYTES
        ray = read_word(arguments, _FILTER_RAY)
        _write_hit(row, ray, hit, instance)
        for k in range(3):
            write_half(row, 20 + 4 * k, read_half(hit, _FOUND_NORMAL + 4 * k))
            write_half(row, 32 + 4 * k, read_half(ray, _RAY_DIRECTION + 4 * k))
    write_half(context, _FOUND_COUNT, count + 1)
    write_half(read_word(arguments, _FILTER_VALID), 0, 0)
