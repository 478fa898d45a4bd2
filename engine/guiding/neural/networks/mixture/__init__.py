# SPDX-License-Identifier: GPL-3.0-or-later
"""Networks that give a mixture of lobes for every point."""
