# SPDX-License-Identifier: GPL-3.0-or-later
"""Packages that NeuralGuide needs in Blender's Python: none may be missing, or be an older one of another add-on's."""

from __future__ import annotations

import importlib.util
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


def missing_packages() -> str:
    """What to say where the zip's packages are not there, as in a Blender with another Python; '' where they are."""
    if "numba" in sys.modules or importlib.util.find_spec("numba") is not None:
        return ""
    python = ".".join(map(str, sys.version_info[:2]))
    return (
        f"NeuralGuide was installed without its packages for Python {python}, which this Blender runs. A Blender of "
        "blender.org has the Python that the zip was made for. For a Blender of a Linux distribution run "
        "`python3 tools/install_legacy.py /usr/bin/blender` in NeuralGuide's sources"
    )
