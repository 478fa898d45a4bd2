# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render has of its networks: sources and predictors that a process of its own trains."""
