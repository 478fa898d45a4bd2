# SPDX-License-Identifier: GPL-3.0-or-later
"""A lane's column is declared once, with the cache line that it lies in."""

from __future__ import annotations

import numpy as np
import pytest

from engine.array_types import Float32Array
from engine.ris.candidates import allocate_candidates
from engine.state import lanes
from engine.state.columns import column, columns_of, dtype_of
from engine.state.media import allocate_media_lanes
from engine.state.tracking import allocate_tracked_lanes

LANES = 6
LINE = 64
TABLES = {
    "paths": lanes.allocate_paths,
    "closures": lanes.allocate_closures,
    "light samples": lanes.allocate_light_samples,
    "shadow rays": lanes.allocate_shadow_rays,
    "radiance cache": lanes.allocate_cached_lanes,
    "light passes": lambda count, channels: lanes.allocate_light_pass_lanes(count, channels, 9),
    "catchers": lanes.allocate_catcher_lanes,
    "media": allocate_media_lanes,
    "tracked": allocate_tracked_lanes,
    "candidates": allocate_candidates,
    "points": lambda count, channels: lanes.allocate_points(count),
    "guided": lambda count, channels: lanes.allocate_guided_lanes(count),
    "features": lambda count, channels: lanes.allocate_feature_lanes(count, count),
    "draws": lambda count, channels: lanes.allocate_light_draws(),
}


class ToyPaths(lanes.PathState):
    """Paths with two columns more."""

    toy: Float32Array = column("toys", "L", 2, fill=3.0, line=0)
    hue: Float32Array = column("only with wavelengths", "L", needs="wavelengths", line=3)


@pytest.mark.parametrize("channel_count", [3, 4])
def test_a_toy_column_lies_in_the_line_that_it_names(channel_count, monkeypatch):
    monkeypatch.setattr(lanes, "PathState", ToyPaths)
    paths = lanes.allocate_paths(LANES, channel_count)
    assert paths.toy.shape == (LANES, 2) and (paths.toy == 3.0).all()
    assert paths.toy.strides[0] == paths.origin.strides[0]
    # It has made the first line two.
    distance = paths.throughput.ctypes.data - paths.origin.ctypes.data
    assert distance == 2 * LINE and paths.origin.ctypes.data < paths.toy.ctypes.data < paths.throughput.ctypes.data
    assert len(paths.hue) == (0 if channel_count == lanes.RGB else LANES)


@pytest.mark.parametrize("channel_count", [3, 4])
@pytest.mark.parametrize("name", TABLES)
def test_columns_are_as_declared_and_share_no_memory(name, channel_count):
    table = TABLES[name](LANES, channel_count)
    declared = columns_of(type(table))
    for number, (field, values) in enumerate((field, getattr(table, field)) for field in declared):
        assert values.dtype == dtype_of(type(table), field)
        # Kinds lie in a column of `param`, on purpose.
        if field != "kind":
            values[...] = number + 1
    for number, field in enumerate(declared):
        assert field == "kind" or (getattr(table, field) == number + 1).all(), field


@pytest.mark.parametrize("name", ["paths", "closures", "light samples", "shadow rays", "radiance cache"])
def test_records_are_whole_cache_lines(name):
    table = TABLES[name](LANES, 4)
    declared = columns_of(type(table))
    for record in {of.record for of in declared.values()}:
        columns = [getattr(table, field) for field, of in declared.items() if of.line >= 0 and of.record == record]
        assert {values.strides[0] % LINE for values in columns} <= {0}
        assert not columns or min(values.ctypes.data for values in columns) % LINE == 0


def test_closures_of_wavelengths_are_those_of_shaders():
    """Shaders are compiled for RGB alone."""
    closures, plain = lanes.allocate_closures(LANES, 4, 2), lanes.allocate_closures(LANES, 3, 2)
    seen = lanes.as_rgb(closures)
    assert seen._numba_type_ == plain._numba_type_ != closures._numba_type_
    assert np.shares_memory(seen.param, closures.param)
