# SPDX-License-Identifier: GPL-3.0-or-later
"""What a guided render decides between iterations: which method, how often to guide, how many candidates."""
