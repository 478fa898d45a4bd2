# SPDX-License-Identifier: GPL-3.0-or-later
"""A page of charts out of the records that `sweep` and `run` leave. Renders nothing."""
