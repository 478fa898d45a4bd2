# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks that learn to guide: found by the names of `engine.methods`, loaded by those renders that use any."""
