# SPDX-License-Identifier: GPL-3.0-or-later
"""The path tracer: it takes a scene description, returns passes, and knows nothing of Blender."""
