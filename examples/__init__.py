# SPDX-License-Identifier: GPL-3.0-or-later
"""Short scripts that use NeuralGuide from Python; README.md beside them says what each shows."""
