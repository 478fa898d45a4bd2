# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells for Russian roulette: how much light a piece of surface sends back, and what finding it costs."""
