# SPDX-License-Identifier: GPL-3.0-or-later
"""What paths record of incident light, and the rows that fields and networks take."""
