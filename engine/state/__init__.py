# SPDX-License-Identifier: GPL-3.0-or-later
"""The arrays that kernels read and write, and their columns."""
