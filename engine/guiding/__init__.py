# SPDX-License-Identifier: GPL-3.0-or-later
"""What the renderer learns about incident light, and how it is asked."""
