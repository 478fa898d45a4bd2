# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what was learned of a scene is still good after the scene was edited: measured, by records of a short render.

The render is guided by the field, and records its vertices. Where light came from is compared with what the guide g and
the BSDF b would have bet on: the mean of log((g + b) / 2b), weighted by what each record has brought to its pixel, is
how much better a half guided vertex knows where to look than an unguided one [nats]. Weighted records estimate the same
integral whatever they were drawn by. Above zero the field is worth having. Below, light comes from elsewhere now, and
what was learned would be in the way.

The judgement depends on the random numbers of the short render. So the field that is kept is another one, with other
random numbers (`LearnedField.seed`): what it guides is independent of how it was judged.

References: Müller 2019, "Path Guiding in Production", on the divergence that guiding is to make small.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from engine.guiding.records.vertices import VertexRecords
from engine.guiding.saved.learned import LearnedField

#: Records that tell something, at least.
LEAST_RECORDS = 2000
#: What samples from before an edit count for.
_KEPT_SHARE = 0.5
#: Largest share of the weights that a record may have.
_OUTLIER_SHARE = 1e-3
#: Rounds of cutting: each brings a single outlier down to a thousandth.
_ROUNDS = 8
#: Largest ratio of the guide's density to the BSDF's that counts.
_LARGEST_RATIO = 1e3


def information_gain(records: VertexRecords, row_count: int) -> float:
    """Mean of log((g + b) / 2b) over where light came from [nats]; NaN where there was none.

    Parameters
    ----------
    records : VertexRecords
        Records of guided paths.
    row_count : int
    """
    guide_pdf, bsdf_pdf = records.guide_pdf[:row_count], records.bsdf_pdf[:row_count]
    weight = np.sqrt(np.maximum(records.contribution_squared[:row_count], 0.0), dtype=np.float64)
    # NaN: vertices that were not guided.
    is_known = (guide_pdf >= 0.0) & (bsdf_pdf >= 0.0) & (guide_pdf + bsdf_pdf > 0.0) & (weight < 1e15)
    weight = weight[is_known]
    for _ in range(_ROUNDS):
        weight = np.minimum(weight, _OUTLIER_SHARE * weight.sum())
    if not weight.sum() > 0.0:
        return math.nan
    guided, plain = guide_pdf[is_known].astype(np.float64), bsdf_pdf[is_known].astype(np.float64)
    ratio = np.minimum(guided / np.maximum(plain, guided / _LARGEST_RATIO), _LARGEST_RATIO)
    return float(np.average(np.log(0.5 * ratio + 0.5), weights=weight))


class FieldJudge:
    """Takes what a render records that was started from a field (`Session.render(start=judge.field, sink=judge)`).

    Parameters
    ----------
    field : LearnedField
        What was learned of the scene before the edit.
    light_digest : str
        Digest of the scene now.

    Attributes
    ----------
    field : LearnedField
        What to render with, to judge it.
    gain : float
        `information_gain` of the newest records; NaN while there are none.
    """

    def __init__(self, field: LearnedField, light_digest: str) -> None:
        self.field = field.of_scene(light_digest)
        self.gain = math.nan
        self._record_count = 0

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Judge by these records; those of an earlier, coarser picture count no more."""
        self._record_count = row_count
        self.gain = information_gain(records, row_count)

    @property
    def is_sure(self) -> bool:
        """Whether there were records enough."""
        return self._record_count >= LEAST_RECORDS

    @property
    def kept(self) -> LearnedField | None:
        """What to go on from; None where it is better to learn anew."""
        fits = self.is_sure and self.gain > 0.0
        return replace(self.field, samples=_KEPT_SHARE * self.field.samples) if fits else None
