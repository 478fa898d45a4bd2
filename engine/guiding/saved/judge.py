# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether what was learned of a scene is still good after the scene was edited: measured, by records of a short render.

The render is guided by the field, and records its vertices. What guiding brings there is estimated as it was while the
field was learned (`engine.guiding.models.selection`): the second moment of the vertices' contributions under BSDF
sampling, over that with the guide. A wall that is red now leaves most of that; light from somewhere else leaves little,
and what was learned would be in the way.

The judgement depends on the random numbers of the short render. So the field that is kept is another one, with other
random numbers (`LearnedField.seed`): what it guides is independent of how it was judged.
"""

from __future__ import annotations

import math
from dataclasses import replace

from engine.guiding.models.regions import RegionModels
from engine.guiding.records.vertices import VertexRecords
from engine.guiding.saved.learned import LearnedField

#: Records that tell something, at least.
LEAST_RECORDS = 2000
#: Share of what guiding brought before, as a logarithm, that is to be left.
LEAST_LEFT = 0.5
#: Guiding that brings less than this has nothing to keep [ratio of second moments].
_LEAST_GAIN = 1.0
#: What samples from before an edit count for.
_KEPT_SHARE = 0.5


class FieldJudge:
    """Takes what a render records that was started from a field (`Session.render(start=judge.field, sink=judge)`).

    Parameters
    ----------
    field : LearnedField
        Of the scene before the edit.
    light_digest : str
        Of the scene now.

    Attributes
    ----------
    field : LearnedField
        What to render with, to judge it.
    gain_before, gain_now : float
        Second moment under BSDF sampling over that with the guide: while the field was learned, and now.
    record_count : int
        That the judgement is by; `is_sure` says whether they are enough.
    """

    def __init__(self, field: LearnedField, light_digest: str) -> None:
        self.field = field.of_scene(light_digest)
        self._regions = RegionModels.of_state(field.state, 0.5)
        self.gain_before = self._regions.gain()
        self.gain_now = math.nan
        self.record_count = 0

    def take(self, records: VertexRecords, row_count: int) -> None:
        """Judge by these records; those of an earlier, coarser picture count no more."""
        self.record_count = row_count
        self.gain_now = self._regions.gain_now(records, row_count)

    @property
    def is_sure(self) -> bool:
        """Whether there were records enough."""
        return self.record_count >= LEAST_RECORDS

    @property
    def fits(self) -> bool:
        """Whether the field is worth keeping."""
        if not self.is_sure or not self.gain_now >= _LEAST_GAIN:
            return False
        return math.log(self.gain_now) >= LEAST_LEFT * math.log(max(self.gain_before, 1.0))

    @property
    def kept(self) -> LearnedField | None:
        """What to go on from; None where it is better to learn anew."""
        return replace(self.field, samples=_KEPT_SHARE * self.field.samples) if self.fits else None
