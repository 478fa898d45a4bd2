# SPDX-License-Identifier: GPL-3.0-or-later
"""On curves bumped normals are taken as they are, as in Cycles: nothing softens or rejects what they scatter."""

from __future__ import annotations

import numpy as np
import pytest

from engine.kernels.bsdf.closures import append_closure, reset_closures
from engine.kernels.bsdf.kinds import BUMP, CLOSURE_IS_ON_STRAND, DIFFUSE
from engine.kernels.bsdf.normals import valid_specular_normal
from engine.runtime.jit import kernel
from engine.state.lanes import CLOSURE_N, allocate_closures

_UP = (np.float32(0.0), np.float32(0.0), np.float32(1.0))
_BUMPED = (np.float32(0.6), np.float32(0.0), np.float32(0.8))
_GRAZING = (np.float32(-0.8), np.float32(0.0), np.float32(0.6))


@kernel
def _append(closures, ns, n, wo, flags, valid):
    reset_closures(closures, 0, ns, flags)
    append_closure(closures, 0, DIFFUSE, (1.0, 1.0, 1.0), n)
    found = valid_specular_normal(closures, 0, ns, wo, n)
    for k in range(3):
        valid[k] = found[k]


@pytest.mark.parametrize("flags", [0, CLOSURE_IS_ON_STRAND])
def test_bumped_normals_are_taken_as_they_are_on_curves(flags: int) -> None:
    closures = allocate_closures(1)
    valid = np.zeros(3, np.float32)
    _append(closures, _UP, _BUMPED, _GRAZING, np.int64(flags), valid)
    assert np.allclose(closures.param[0, 0, CLOSURE_N : CLOSURE_N + 3], _BUMPED)
    assert (closures.param[0, 0, BUMP] != 0.0) == (flags == 0)
    assert np.allclose(valid, _BUMPED) == (flags != 0)
