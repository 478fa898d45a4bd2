# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render learns from what its paths record."""
