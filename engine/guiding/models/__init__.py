# SPDX-License-Identifier: GPL-3.0-or-later
"""What learns a source of directions from the records of each iteration."""
