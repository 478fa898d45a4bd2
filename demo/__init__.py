# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a room with NeuralGuide and with Cycles in the same seconds, and says how far each is off."""
