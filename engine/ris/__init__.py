# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampled importance sampling and how many candidates it is worth."""
