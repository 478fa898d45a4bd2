# SPDX-License-Identifier: GPL-3.0-or-later
"""Decodes a network's outputs into lobes, and evaluates and samples their mixture."""
