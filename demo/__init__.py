# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: a scene worth looking at, built from what Blender ships, and a script that renders it."""
