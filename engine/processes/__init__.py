# SPDX-License-Identifier: GPL-3.0-or-later
"""Processes that the renderer starts, and memory that it shares with them."""
