# SPDX-License-Identifier: GPL-3.0-or-later
"""The SD-tree: `model` learns it, `field` is what the model publishes, `query` reads that."""
