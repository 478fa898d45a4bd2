# SPDX-License-Identifier: GPL-3.0-or-later
"""Masks of rays: which instances a ray finds. The lower bits are those of visibility (`state.geometry`)."""

from __future__ import annotations

#: rays a shadow ray's mask selects: blockers whose every material is opaque, and the others
MASK_SHADOW_OPAQUE = 64
MASK_SHADOW_TRANSPARENT = 128
#: what has a medium inside: its boundaries are looked for apart from all else
MASK_MEDIUM = 256
#: what rays of Raycast nodes meet
MASK_RAYCAST = 1 << 15
#: By so many bits higher are the masks of rays that see shadow catchers only.
CATCHER_MASK_SHIFT = 16
#: Bits for the objects that cast shadows in the light of emitters with collections of blockers, one a choice. They lie
#: below MASK_RAYCAST, and are free above it too.
BLOCKER_BITS = tuple(range(9, 15))
#: More of them where nothing is a shadow catcher. Masks of emitters are signed, so the last bit is none.
BLOCKER_BITS_WITHOUT_CATCHERS = (*BLOCKER_BITS, *range(CATCHER_MASK_SHIFT, 31))
