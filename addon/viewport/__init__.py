# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendered shading: sends what has changed to a process that renders, and draws the pictures that come back."""
