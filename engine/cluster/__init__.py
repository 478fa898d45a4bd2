# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders one frame on several machines: workers hold the built scene and render ranges of its samples."""
