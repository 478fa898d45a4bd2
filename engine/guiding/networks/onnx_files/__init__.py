# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks as `.onnx` files, which need no package to be written or read."""
