# SPDX-License-Identifier: GPL-3.0-or-later
"""Resampled importance sampling, and the number of candidates that pays."""
