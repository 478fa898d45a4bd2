# SPDX-License-Identifier: GPL-3.0-or-later
"""What all questions of a render read: whether guiding goes on, and whether there are pixels enough to compare."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass
class Standing:
    """Where guiding stands, or the radiance cache.

    is_over : bool, it has been given up: the question whether it is worth it writes that
    is_narrow : bool, a noise threshold has left so few pixels that nothing is compared any more
    """

    is_over: bool = False
    is_narrow: bool = False
