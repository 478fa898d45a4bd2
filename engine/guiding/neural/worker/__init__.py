# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that trains networks: the only importer of torch."""
