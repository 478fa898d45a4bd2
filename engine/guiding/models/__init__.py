# SPDX-License-Identifier: GPL-3.0-or-later
"""The models that learn from the records of each iteration."""
