# SPDX-License-Identifier: GPL-3.0-or-later
"""Turns a scene description into the arrays that kernels read, with the light tree and the Embree scenes."""
