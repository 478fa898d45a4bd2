# SPDX-License-Identifier: GPL-3.0-or-later
"""NeuralGuide's path tracer: knows nothing of Blender, speaks `scene.description` at its door."""
