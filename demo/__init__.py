# SPDX-License-Identifier: GPL-3.0-or-later
"""The demo: a room rendered by NeuralGuide and by Cycles in the same seconds, and by how much they are off."""
