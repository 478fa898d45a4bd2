# SPDX-License-Identifier: GPL-3.0-or-later
"""Addresses of the kernels that Embree calls."""

from __future__ import annotations

from functools import cache

from engine.runtime.jit import BoundKernel, Kernel


@cache
def address_of(called: Kernel) -> int:
    """Where Embree calls a kernel with the address of its arguments; 0 where nothing is compiled."""
    if not isinstance(called, Kernel):
        return 0
    bound = BoundKernel(called)
    bound.bind(0)
    return bound.c_address
