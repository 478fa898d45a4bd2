# SPDX-License-Identifier: GPL-3.0-or-later
"""Ranges of opcodes. A group of instructions owns one range and numbers its opcodes in its own module."""

INPUT_FIRST = 0  # engine/kernels/shader/ops_input.py
DISPLACEMENT_FIRST = 80  # engine/kernels/shader/ops_displacement.py, run by that
RAYS_FIRST = 90  # engine/kernels/shader/ops_rays.py
CLOSURE_FIRST = 100  # engine/kernels/shader/ops_closure.py
VOLUME_FIRST = 170  # engine/kernels/shader/ops_volume.py, run as closures
IMAGE_FIRST = 200  # engine/kernels/shader/ops_image.py
MATH_FIRST = 300  # engine/kernels/shader/ops_math.py
TEXTURE_FIRST = 400  # engine/kernels/shader/ops_texture.py
PATTERNS_FIRST = 450  # engine/kernels/shader/ops_patterns.py, called by linked_patterns.py
