# SPDX-License-Identifier: GPL-3.0-or-later
"""Skies: what the air of the earth sends down from a sun, as maps and as formulas."""
