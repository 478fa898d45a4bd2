# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders scenes with NEURALGUIDE and its rivals in one process, and compares pictures and times."""
