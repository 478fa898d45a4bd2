# SPDX-License-Identifier: GPL-3.0-or-later
"""The yardstick: renders scenes with NEURALGUIDE and its rivals in one process and compares pictures and times."""
