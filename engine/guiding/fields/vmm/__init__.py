# SPDX-License-Identifier: GPL-3.0-or-later
"""Von Mises-Fisher mixtures with parallax: `model` learns them, `field` publishes them, `query` reads them."""
