# SPDX-License-Identifier: GPL-3.0-or-later
"""The scene description, which hosts fill in, and digests of it."""
