# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds furnished rooms."""
