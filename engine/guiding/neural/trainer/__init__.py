# SPDX-License-Identifier: GPL-3.0-or-later
"""The renderer's handle on the process that trains networks."""
