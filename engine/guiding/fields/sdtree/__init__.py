# SPDX-License-Identifier: GPL-3.0-or-later
"""The SD-tree field: `model` learns, `field` is what it publishes, `query` reads it."""
