# SPDX-License-Identifier: GPL-3.0-or-later
"""Rendering for a window: a process of its own traces, the host sends what has changed and shows pictures."""
