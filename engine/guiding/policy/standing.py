# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether something is still done in a render: the question whether it is worth it writes that, all others read it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Standing:
    """Where guiding stands, or the radiance cache.

    is_over : bool, it has been given up
    """

    is_over: bool = False
