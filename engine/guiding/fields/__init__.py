# SPDX-License-Identifier: GPL-3.0-or-later
"""Statistical fields of incident light, which are fitted between iterations without a network."""
