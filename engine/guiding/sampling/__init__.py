# SPDX-License-Identifier: GPL-3.0-or-later
"""What stages draw directions by, whichever method is in use."""
