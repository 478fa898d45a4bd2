# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures whose parameters a network gives for every point: shape, features, inference (training is the worker's)."""
