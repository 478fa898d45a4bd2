# SPDX-License-Identifier: GPL-3.0-or-later
"""Of which surfaces guides multiply the cosine in: those that mostly scatter diffusely, and let no light through."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf import rough_share
from tests.helpers.bsdf_harness import DIFFUSE, GLASS, GLOSSY, PRINCIPLED, TRANSLUCENT, Case, Lobes, at_cosine


@pytest.mark.parametrize(
    ("case", "expected"),
    [
        (Case(DIFFUSE), True),
        # What Blender gives to new objects: a coat of gloss on a diffuse base.
        (Case(PRINCIPLED), True),
        (Case(PRINCIPLED, {"sheen_weight": 1.0}), True),
        (Case(PRINCIPLED, {"color": (0.02, 0.02, 0.02)}), False),
        (Case(PRINCIPLED, {"metallic": 1.0}), False),
        (Case(PRINCIPLED, {"transmission": 0.5}), False),
        (Case(GLOSSY, {"roughness": 0.5}), False),
        (Case(GLASS, {"roughness": 0.5}), False),
        (Case(TRANSLUCENT), False),
    ],
    ids=str,
)
def test_the_cosine_is_part_of_the_product_where_most_samples_are_diffuse(case: Case, expected: bool) -> None:
    lobes = Lobes(case, wo=at_cosine(0.7))
    share, is_diffuse = rough_share(lobes.closures, 0, np.float32(0.0))
    assert share == pytest.approx(1.0)
    assert is_diffuse == expected
