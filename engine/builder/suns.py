# SPDX-License-Identifier: GPL-3.0-or-later
"""Suns of half angle a: radiance irradiance / (pi sin(a)^2).

A sun that is not normalised takes 1 for pi sin(a)^2.
"""

from __future__ import annotations

import math

import numpy as np

from engine.builder.lamp_kind import LampColumns, LampDraft, LampKind
from engine.kernels.lights import sun
from engine.state import lights as la


def _convert_suns(lamps: LampColumns, draft: LampDraft) -> None:
    half = 0.5 * np.minimum(math.pi, np.maximum(0.0, lamps.own["angle"]))
    sine, sine_half = np.sin(half), np.sin(0.5 * half)
    draft.values[:, la.LAMP_P : la.LAMP_P + 3] = -lamps.direction
    draft.values[:, sun.ONE_MINUS_COS] = 2.0 * (sine_half * sine_half)
    draft.values[:, sun.TO_X : sun.TO_Y + 3] = lamps.inverse_axes[:, :2].reshape(-1, 6)
    has_angle = half > 0.0
    disc = np.where(has_angle, math.pi * (sine * sine), 1.0)
    draft.scale = np.where(has_angle & lamps.is_normalized, 1.0 / disc, 1.0)
    draft.make_delta(~has_angle)
    draft.distant = np.stack([np.cos(half), sine, lamps.mean * draft.scale * disc], axis=1)


SUNS = LampKind(sun.LAMP, _convert_suns, measures=("angle",), example={"angle": 0.8})
