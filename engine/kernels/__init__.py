# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiled functions for single samples: random numbers, vectors, camera, motion, light sums."""
