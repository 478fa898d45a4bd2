# SPDX-License-Identifier: GPL-3.0-or-later
"""Mixtures of lobes that a network's outputs stand for: decoding, density and sampling."""
