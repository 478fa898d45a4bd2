# SPDX-License-Identifier: GPL-3.0-or-later
"""What several tests of renders look at."""

from __future__ import annotations

import pytest

from engine.render.film import Film


@pytest.fixture
def film_weights(monkeypatch):
    """Pixels' weights once all is rendered."""
    found = []

    def merged(film, pixels, tile, weight=1.0, merge=Film.merge):
        merge(film, pixels, tile, weight)
        found.append(film)

    monkeypatch.setattr(Film, "merge", merged)
    return lambda: found[-1].sums.weight
