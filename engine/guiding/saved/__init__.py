# SPDX-License-Identifier: GPL-3.0-or-later
"""Keeps what a render has learned for later renders, in memory or in a file."""
