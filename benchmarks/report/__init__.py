# SPDX-License-Identifier: GPL-3.0-or-later
"""Makes a page of charts out of the records that `sweep` and `run` leave."""
