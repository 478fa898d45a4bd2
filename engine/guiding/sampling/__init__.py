# SPDX-License-Identifier: GPL-3.0-or-later
"""Draws directions and evaluates their density by the source in use."""
