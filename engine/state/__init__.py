# SPDX-License-Identifier: GPL-3.0-or-later
"""Arrays that kernels read and write, and the columns in them."""
