# SPDX-License-Identifier: GPL-3.0-or-later
"""Learns the incident light while a render runs, and samples directions by it."""
