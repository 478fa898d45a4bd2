# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles kernels, keeps their machine code, and makes the bundles and tables that they take."""
