# SPDX-License-Identifier: GPL-3.0-or-later
"""Neural importance sampling: a normalising flow on the sphere."""
