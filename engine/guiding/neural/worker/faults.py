# SPDX-License-Identifier: GPL-3.0-or-later
"""What keeps a network from being trained, in words for people. Knows no torch, which may be what is missing."""

from __future__ import annotations


class DeviceError(ValueError):
    """A network cannot be trained on what was asked for."""
