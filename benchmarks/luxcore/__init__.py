# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders scenes with LuxCore too: bidirectional, with photons, and both ways at once; `pyluxcore` comes on request."""
