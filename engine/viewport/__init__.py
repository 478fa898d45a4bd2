# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders for a window: a process of its own traces, the host sends changes and shows pictures."""
