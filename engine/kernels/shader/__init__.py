# SPDX-License-Identifier: GPL-3.0-or-later
"""The interpreter of shader programs, with textures and grids."""
