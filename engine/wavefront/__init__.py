# SPDX-License-Identifier: GPL-3.0-or-later
"""The stages that paths go through, a file each, and the loop over them."""
