# SPDX-License-Identifier: GPL-3.0-or-later
"""Many lamps are converted at once: each becomes what it becomes alone, and what is broken is named and left out."""

from __future__ import annotations

import math

import numpy as np
import pytest

from engine.builder.emission import ProgramInfo
from engine.builder.lamps import convert_lamps
from engine.builder.light_tree import BOUNDS_ENERGY
from engine.scene.description import Light
from engine.state import lights as la

COUNT = 400
PROGRAM_COUNT = 4


def some_lights(seed):
    """Lights of every kind; some squeezed flat, some with NaN, some without strength or size."""
    random = np.random.default_rng(seed)

    def one_of(*items):
        return items[random.integers(len(items))]

    found = []
    for index in range(COUNT):
        transform = np.eye(4, dtype=np.float32)
        transform[:3] = random.normal(size=(3, 4))
        if index % 20 == 1:
            transform[:3, 1] = 0.0
        if index % 50 == 2:
            transform[0, 3] = np.nan
        found.append(
            Light(
                key=index, name=f"L{index}", kind=one_of("POINT", "SPOT", "AREA", "SUN"), transform=transform,
                color=one_of((1.0, 1.0, 1.0), (0.5, 0.2, 0.1), (0.0, 0.0, 0.0)), energy=one_of(10.0, -3.0, 0.0),
                is_normalized=one_of(True, False), radius=one_of(0.0, -1.0, 0.3), angle=one_of(0.0, 0.2, 4.0),
                spot_angle=random.uniform(0.01, 3.1), spot_blend=one_of(0.0, 0.4, 1.0),
                shape=one_of("SQUARE", "RECTANGLE", "DISK", "ELLIPSE"), size_x=one_of(0.0, 0.7), size_y=0.4,
                spread=one_of(0.0, 0.05, 1.0, math.pi), use_soft_falloff=one_of(True, False),
                cast_shadow=one_of(True, False), use_mis=one_of(True, False), max_bounces=one_of(3, 2**31 - 1),
                visibility=int(random.integers(64)), temperature=one_of(0.0, 3000.0),
            )
        )
    return found


def programs(light_program):
    return ProgramInfo(
        has_emission=np.ones(PROGRAM_COUNT, bool),
        emission_is_constant=np.array([True, False, True, False]),
        emission_estimate=np.array([[2, 1, 0.5], [1, 1, 1], [0, 0, 0], [0.1, 0.2, 0.3]], np.float32),
        temperature=np.array([0, 4000, 0, 0], np.float32),
        sampling_mode=np.zeros(PROGRAM_COUNT, np.int32),
        light_program=np.array(light_program, np.int32),
    )


def test_all_at_once_are_what_each_is_alone():
    lights = some_lights(1)
    of_light = np.random.default_rng(2).integers(-1, PROGRAM_COUNT, COUNT)
    notices, alone, notices_alone = [], {}, []
    together = convert_lamps(lights, programs(of_light), notices)
    for index, light in enumerate(lights):
        one = convert_lamps([light], programs(of_light[index : index + 1]), notices_alone)
        if len(one.values):
            alone[index] = one
    assert notices == notices_alone
    assert 0.2 * COUNT < len(alone) < 0.8 * COUNT
    order = together.order
    assert (np.diff(order) >= 0).all() and set(order) == {0, 1, 2, 3}
    assert sorted(together.table[:, la.LAMP_LIGHT]) == sorted(alone)
    for row, index in enumerate(together.table[:, la.LAMP_LIGHT]):
        one = alone[int(index)]
        one.table[0, la.LAMP_LIGHT] = index
        for name in ("values", "table", "bounds", "distant"):
            np.testing.assert_array_equal(getattr(together, name)[row], getattr(one, name)[0], name)


def lamp(kind, **more):
    return Light(key=0, name="Lamp", kind=kind, transform=np.eye(4, dtype=np.float32), color=(1.0, 1.0, 1.0),
                 energy=100.0, **more)  # fmt: skip


@pytest.mark.parametrize(
    ("light", "radiance"),
    [
        (lamp("POINT", radius=0.5), 100 / (4 * math.pi**2 * 0.5**2)),
        (lamp("SPOT", radius=0.5, is_normalized=False), 100 / math.pi),
        (lamp("AREA", shape="RECTANGLE", size_x=2.0, size_y=3.0), 100 / (math.pi * 6.0)),
        (lamp("AREA", shape="DISK", size_x=2.0), 100 / (math.pi * math.pi)),
        (lamp("SUN", angle=0.4), 100 / (math.pi * math.sin(0.2) ** 2)),
    ],
)
def test_radiance_is_that_of_blenders_units(light, radiance):
    found = convert_lamps([light], programs([]), [])
    np.testing.assert_allclose(found.values[0, la.LAMP_RADIANCE : la.LAMP_RADIANCE + 3], radiance, rtol=1e-6)


def test_a_points_peak_is_its_intensity():
    """Power over 4 pi, times what a sphere of radiance L sends one way, pi L r^2, over its share of all ways."""
    found = convert_lamps([lamp("POINT", radius=0.5)], programs([]), [])
    assert found.bounds[0, BOUNDS_ENERGY] == pytest.approx(100 / (4 * math.pi), rel=1e-6)


def test_what_is_broken_is_left_out_by_name():
    lights = [lamp("POINT"), lamp("AREA", size_x=0.0), lamp("SPOT")]
    lights[0].transform[1, 1] = np.inf
    lights[2].transform[:3, 0] = 0.0
    notices = []
    assert not len(convert_lamps(lights, programs([]), notices).values)
    assert [notice.subject for notice in notices] == ["light Lamp"]
    with pytest.raises(ValueError, match="kind is 'TORCH', choose POINT, SPOT, AREA, SUN"):
        convert_lamps([lamp("TORCH")], programs([]), [])


def test_no_lamps_are_no_rows():
    found = convert_lamps([], programs([]), [])
    assert found.values.shape == (0, la.LAMP_WIDTH) and not len(found.order)
