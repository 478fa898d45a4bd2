# SPDX-License-Identifier: GPL-3.0-or-later
"""What paths record of incident light, and the forms in which fields and networks take it."""
