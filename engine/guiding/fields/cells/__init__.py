# SPDX-License-Identifier: GPL-3.0-or-later
"""The cells of the radiance cache: each keeps the light that arrives at a piece of surface."""
