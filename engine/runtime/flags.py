# SPDX-License-Identifier: GPL-3.0-or-later
"""Flags of kernels, which numba compares at every operator that it looks up.

Equal flags are one object, whose hash is found once. Numba makes new ones for each function, and each comparison asks
for all thirty values.
"""

from __future__ import annotations

import threading
from typing import Any

from numba.core.compiler import Flags


class KernelFlags(Flags):  # type: ignore[misc]
    """Numba's flags, once nobody changes them any more.

    Parameters
    ----------
    flags : Flags
        To copy.
    """

    def __init__(self, flags: Flags) -> None:
        super().__init__(flags)
        self._hash = hash(flags)

    def __hash__(self) -> int:
        return self._hash

    def __eq__(self, other: object) -> Any:
        return self is other or super().__eq__(other)

    def copy(self) -> KernelFlags:
        """Itself: nobody changes it."""
        return self


_kept: dict[Flags, KernelFlags] = {}
_keeping = threading.Lock()


def keep_flags(flags: Flags) -> KernelFlags:
    """The flags that stand for all that equal these."""
    if flags.no_cpython_wrapper and flags.no_cfunc_wrapper:
        # Nothing but other kernels calls such a function: `KernelLowering` makes no machine code of it.
        flags.no_compile = True
    with _keeping:
        if flags not in _kept:
            _kept[flags] = KernelFlags(flags)
        return _kept[flags]
