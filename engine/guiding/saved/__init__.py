# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render has learned, kept for later ones: in memory, and as a file."""
