# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render has learned of a scene, to start others of the same scene from."""

from __future__ import annotations

import zlib
from dataclasses import dataclass, replace
from functools import cached_property

from engine.guiding.fields.state import State, part
from engine.guiding.fields.vmm.field import VmmField
from engine.guiding.fields.vmm.model import VmmModel
from engine.scene.digest import content_digest
from engine.settings import MAX_SEED

#: What comparisons with unguided rendering said.
WON, LOST, OPEN = "WON", "LOST", "OPEN"
VERDICTS = (WON, LOST, OPEN)


@dataclass(frozen=True)
class LearnedField:
    """Immutable, for any number of renders at the same time.

    state : arrays of `RegionModels.state`, and those of the table under 'table'
    light_digest : of the scene it was learned in (`engine.scene.digest.light_digest`)
    rung : method in use at the end (`engine.methods.RUNGS` of AUTO, else the method itself)
    verdict : of comparing guiding with unguided rendering, one of VERDICTS
    efficiency : guiding's over unguided rendering's when last compared; 0: never
    samples : a pixel that it was learned from, those of the renders included that this one started from
    records_per_path : of paths that were recorded
    ray_count : cost of a path [rays]
    variance : of a sample of a pixel, relative (`engine.ris.orca.image_variance`)
    brightness : mean of the image
    """

    state: State
    light_digest: str
    rung: str
    verdict: str = OPEN
    efficiency: float = 0.0
    samples: float = 0.0
    records_per_path: float = 4.0
    ray_count: float = 1.0
    variance: float = 0.0
    brightness: float = 0.0

    @cached_property
    def digest(self) -> str:
        """A digest of all that was learned."""
        return content_digest(self)

    @cached_property
    def field(self) -> VmmField:
        """The mixture field, made once for all renders that start from this.

        Raises
        ------
        StateError
            If the arrays are no state of a model.
        """
        return VmmModel.of_state(part(self.state, "mixture")).field

    @property
    def region_count(self) -> int:
        """Regions of the mixture field."""
        return len(self.state["mixture.region_leaf"])

    def seed(self, seed: int) -> int:
        """The seed of a render that starts from this and was given `seed`.

        What was learned depends on the random numbers that it was learned from. A render that starts from it must not
        use them again: where samples know the density that they are drawn with, their mean is not the image.
        """
        return zlib.crc32(f"{seed} {self.digest}".encode()) & MAX_SEED

    def of_scene(self, light_digest: str) -> LearnedField:
        """The same, said to be of another scene: for who looks whether it still fits (`FieldJudge`)."""
        made = replace(self, light_digest=light_digest)
        made.__dict__["field"] = self.field
        return made

    def __str__(self) -> str:
        return f"{self.samples:g} samples a pixel, {self.region_count} regions"
