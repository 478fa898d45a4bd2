# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks as the renderer sees them: shapes, encodings, and the kernels that ask them."""
