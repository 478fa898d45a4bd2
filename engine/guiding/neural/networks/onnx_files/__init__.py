# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes networks to `.onnx` files and reads them, with no other package."""
