# SPDX-License-Identifier: GPL-3.0-or-later
"""From a loaded scene to an image: the session, its threads, the tracer, the film."""
