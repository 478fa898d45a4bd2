# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles node graphs to the programs that the interpreter runs."""
