# SPDX-License-Identifier: GPL-3.0-or-later
"""Furnished rooms, and what they are furnished with."""
