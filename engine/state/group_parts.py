# SPDX-License-Identifier: GPL-3.0-or-later
"""Columns of light groups where paths end in the radiance cache and some measure what it lacks.

Cells know no groups. Lanes and film keep what cells said as a part of its own behind those of the groups; then, of
measuring paths, what they found behind the place where others end: a part for each group, and one for light of none.
The parts of media come last, in scenes without any too.
"""

from __future__ import annotations

#: `LightPassLanes.is_open` of measuring paths.
PARTS_MEASURED = 4
#: `UNIT_SPLITS_LIGHT` of units whose paths measure by group.
SPLITS_MEASURED = 2

# Columns of `FilmTile.light` behind its parts, for each group and for none: the second half of what was found, RGB, and
# squares of the addends, mean over channels.
FOUND_SECOND = 0
FOUND_SQUARE = 3
FOUND_WIDTH = 4


def measured_part_count(group_count: int) -> int:
    """Parts behind those of so many light groups: what cells said, and what was found of each and of none."""
    return 2 + group_count
