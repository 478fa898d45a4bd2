# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes generated pages, kernels ahead of time, zips and releases."""
