# SPDX-License-Identifier: GPL-3.0-or-later
"""The parallax-aware von Mises-Fisher mixture field: `model` learns, `field` is what it publishes, `query` reads it."""
