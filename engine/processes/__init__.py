# SPDX-License-Identifier: GPL-3.0-or-later
"""Starts Python processes that end with this one, and shares memory and files with processes."""
