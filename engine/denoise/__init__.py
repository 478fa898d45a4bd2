# SPDX-License-Identifier: GPL-3.0-or-later
"""Takes the noise out of finished pictures."""
