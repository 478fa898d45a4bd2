# SPDX-License-Identifier: GPL-3.0-or-later
"""What kernels are made with and run on: compilation, bundles of arrays, the table of stages, Embree."""
