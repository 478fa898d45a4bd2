# SPDX-License-Identifier: GPL-3.0-or-later
"""Decides between iterations: which method renders, how often to guide, how many candidates to draw."""
