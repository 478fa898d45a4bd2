# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders a loaded scene into passes: session, schedule, threads, tracer, film."""
