# SPDX-License-Identifier: GPL-3.0-or-later
"""A scene description becomes arrays that kernels read, light tree and Embree scenes included."""
