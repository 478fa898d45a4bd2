# SPDX-License-Identifier: GPL-3.0-or-later
"""The process that trains the radiance network; the only part of the engine that knows torch."""
