# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of surface that know how much light is sent back there, and at what cost it is found: for Russian roulette."""
