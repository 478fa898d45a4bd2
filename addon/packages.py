# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that somebody else may have loaded into Blender's Python before: it has each of them once."""

from __future__ import annotations

import re
import sys

#: The numba that NeuralGuide brings and was tested with.
_NUMBA = (0, 68)


def older_numba() -> str:
    """What to say of a numba that was loaded by another add-on and is too old; '' where there is none."""
    loaded = sys.modules.get("numba")
    version = str(getattr(loaded, "__version__", ""))
    numbers = tuple(int(number) for number in re.findall(r"\d+", version)[: len(_NUMBA)])
    if not numbers or numbers >= _NUMBA:
        return ""
    place = getattr(loaded, "__file__", None) or "an unknown place"
    return (
        f"another add-on has loaded numba {version} (from {place}), and NeuralGuide was made for "
        f"{'.'.join(map(str, _NUMBA))} and newer: disable that add-on, and start Blender again"
    )
