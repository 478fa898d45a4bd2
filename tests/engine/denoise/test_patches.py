# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves otherwise than its surface is found near it; what looks the same everywhere stays where the surface is."""

import numpy as np

from engine.denoise.patches import most_alike

HEIGHT, WIDTH = 70, 40


def test_a_pattern_that_has_moved_is_found_and_a_flat_wall_is_not_searched():
    pattern = np.random.default_rng(3).uniform(0.0, 1.0, (HEIGHT, WIDTH, 3)).astype(np.float32)
    pattern[:, WIDTH // 2 :] = 0.5
    places = np.indices((HEIGHT, WIDTH))
    rows, columns = most_alike(
        pattern, np.full((HEIGHT, WIDTH), 1e3, np.float32), np.roll(pattern, (1, -2), (0, 1)), tuple(places)
    )
    # Away from the edges; bands of rows that different threads take meet at row 64.
    moving, flat = (slice(3, -3), slice(3, WIDTH // 2 - 4)), (slice(None), slice(WIDTH // 2 + 3, -3))
    assert np.array_equal((rows - places[0])[moving], np.ones_like(rows[moving]))
    assert np.array_equal((columns - places[1])[moving], np.full_like(columns[moving], -2))
    assert np.array_equal(rows[flat], places[0][flat])
    assert np.array_equal(columns[flat], places[1][flat])
