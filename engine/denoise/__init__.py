# SPDX-License-Identifier: GPL-3.0-or-later
"""Taking the noise out of finished pictures: `filter.denoise`."""
