# SPDX-License-Identifier: GPL-3.0-or-later
"""Builds Embree's scenes and casts rays; nothing outside touches Embree."""
