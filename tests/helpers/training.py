# SPDX-License-Identifier: GPL-3.0-or-later
"""What tests of training share."""

from __future__ import annotations

import sys
from typing import Any

import pytest


def require_torch() -> Any:
    """The module torch; where it is not installed, the test (or the file) that asks is skipped."""
    lock = f"requirements-{sys.version_info.major}.{sys.version_info.minor}.lock"
    return pytest.importorskip("torch", reason=f"this trains networks, and torch is not installed: see {lock}")
