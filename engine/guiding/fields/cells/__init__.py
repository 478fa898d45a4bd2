# SPDX-License-Identifier: GPL-3.0-or-later
"""Cells of surface that keep the light which arrives in them: what ends paths (`engine.wavefront.end_in_cache`)."""
