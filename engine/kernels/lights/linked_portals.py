# SPDX-License-Identifier: GPL-3.0-or-later
"""Calls of the kernels of light portals (`portals.py`) by their addresses, and finding these where a scene has one."""

from __future__ import annotations

from typing import Any

from numba import types
from numba.extending import intrinsic

from engine.array_types import Int64Array
from engine.kernels.addresses import kernel_address, kernel_call
from engine.kernels.lights.portals import portal_pdf, sample_portals
from engine.runtime.bundle import FieldType
from engine.runtime.jit import kernel
from engine.state.portals import PORTAL_PDF, PORTAL_SAMPLE, PORTAL_SHARE, PORTAL_WIDTH, no_portal_kernels

_PORTALS = FieldType(types.float32, (PORTAL_WIDTH,))
_VECTOR = types.UniTuple(types.float32, 3)
_SAMPLED = types.UniTuple(types.float32, 4)
_PDF = types.UniTuple(types.float32, 2)
_SAMPLE_TYPES = (_PORTALS, _VECTOR, types.float32, types.float32)
_PDF_TYPES = (_PORTALS, _VECTOR, _VECTOR)

_sample = kernel_call(_SAMPLED, *_SAMPLE_TYPES)
_pdf = kernel_call(_PDF, *_PDF_TYPES)


@intrinsic
def _call_sample(typing_context: Any, address: Any, portals: Any, p: Any, u0: Any, u1: Any) -> Any:
    return _sample((portals, p, u0, u1))


@intrinsic
def _call_pdf(typing_context: Any, address: Any, portals: Any, p: Any, wi: Any) -> Any:
    return _pdf((portals, p, wi))


@kernel(forceinline=True)
def has_portals(lights):
    """Whether directions of the background are drawn through portals too."""
    return lights.portals.shape[0] > 0


@kernel(forceinline=True)
def of_portals(lights, u):
    """Whether a random number says to draw through portals (if there is one to do so), and what is left of it."""
    if not has_portals(lights):
        return False, u
    share = lights.portals[0, PORTAL_SHARE]
    if u < share:
        return True, u / share
    return False, (u - share) / (1.0 - share)


@kernel
def sample_linked_portals(lights, p, u0, u1):
    """As `sample_portals`."""
    return _call_sample(lights.portal_kernels[PORTAL_SAMPLE], lights.portals, p, u0, u1)


@kernel
def with_portals(lights, p, wi, of_map, pmf):
    """Density [sr^-1] of a direction of the background with portals.

    Parameters
    ----------
    p : receiver [m]; wi : unit direction that lies in no disc
    of_map : float32 [sr^-1], without portals
    pmf : float32, with which the background is chosen; `of_map` has it
    """
    pdf, possible = _call_pdf(lights.portal_kernels[PORTAL_PDF], lights.portals, p, wi)
    if not possible > 0.0:
        return of_map
    share = lights.portals[0, PORTAL_SHARE]
    return (1.0 - share) * of_map + share * pmf * pdf


def link_portals() -> Int64Array:
    """Load or compile the kernels of portals: `LightArrays.portal_kernels`."""
    addresses = no_portal_kernels()
    addresses[PORTAL_SAMPLE] = kernel_address(sample_portals, _SAMPLED, *_SAMPLE_TYPES)
    addresses[PORTAL_PDF] = kernel_address(portal_pdf, _PDF, *_PDF_TYPES)
    return addresses
