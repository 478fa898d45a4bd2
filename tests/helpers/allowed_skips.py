# SPDX-License-Identifier: GPL-3.0-or-later
"""Why a test may be skipped where everything is said to be there (CI): for another Blender or Python, or for time.

What else a test needs is in a lock file or installed by .ci/run.
"""

from __future__ import annotations

import os
import re
import sys

from tests.helpers import enough_time

#: Tests that are of another Blender than the one that runs them say so.
_OTHER_BLENDER = re.compile(r"\bBlender\b")

#: Packages that Python 3.11 alone has; requirements-3.13.lock says why.
_OF_PYTHON_311 = ("torch", "ziglang")


def is_allowed(reason: str) -> bool:
    """Whether a test may be skipped for a reason."""
    if _OTHER_BLENDER.search(reason):
        return True
    if enough_time.REASON in reason:
        return enough_time.VARIABLE in os.environ
    if any(package in reason for package in _OF_PYTHON_311):
        return sys.version_info[:2] != (3, 11)
    # CI was told to go without.
    return "Python 3.13" in reason and bool(os.environ.get("NEURALGUIDE_WITHOUT_PYTHON_313"))
