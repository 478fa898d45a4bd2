# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered shading: what has changed goes to a process that renders, pictures come back and are drawn."""
