# SPDX-License-Identifier: GPL-3.0-or-later
"""What a checkpoint is of, and whether another render may go on from it."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import asdict, dataclass, fields
from typing import Any

from engine.guiding.saved.learned import LearnedField
from engine.render.loop_state import LoopState
from engine.render.request import RenderRequest
from engine.runtime.source_version import source_version
from engine.scene.digest import content_digest
from engine.settings import RenderSettings

#: Settings that no sum of the film depends on: when the render ends, what is made of the film then, and by how many.
_FREE = frozenset({
    "samples", "time_limit", "adaptive_threshold", "adaptive_min_samples", "denoised_threshold", "use_denoising",
    "denoising_input_passes", "denoising_prefilter", "denoising_quality", "threads", "texture_memory",
    "training_device", "deterministic",
})  # fmt: skip


@dataclass(frozen=True)
class Identity:
    """What a film is a film of.

    version : of the engine (`source_version`): what its columns mean
    scene : digest of the description (`engine.scene.digest.scene_digest`), camera and frame included
    layout : digest of the film's columns and size
    settings : values by name of the settings that its sums depend on
    """

    version: str
    scene: str
    layout: str
    settings: dict[str, Any]

    @classmethod
    def of_request(cls, request: RenderRequest, scene: str, seed: int) -> Identity:
        """Of the film that a render makes of the scene of this digest, by the seed that was asked for.

        What a render starts from gives it another one (`LearnedField.seed`), which is the checkpoint's.
        """
        settings = {name: value for name, value in asdict(request.settings).items() if name not in _FREE}
        settings["seed"] = seed
        layout = content_digest((request.layout, request.frame.region, max(request.settings.strata, 1)))
        return cls(source_version(), scene, layout, settings)

    def difference(self, other: Identity, free: Collection[str] = ()) -> str:
        """Why a render of `other` cannot go on from a film of this, as what the film is; '' if it can.

        `free` names settings that may be others.
        """
        if self.version != other.version:
            return "was made by another version of NeuralGuide"
        if self.scene != other.scene:
            return "is of another scene, or of this one before it was changed"
        names = [item.name for item in fields(RenderSettings) if item.name not in free]
        changed = [name for name in names if self.settings.get(name) != other.settings.get(name)]
        if changed:
            return f"was made by other settings ({', '.join(changed)})"
        if self.layout != other.layout:
            return "was made for other passes, for another size, or to be denoised otherwise"
        return ""


@dataclass(frozen=True)
class Checkpoint:
    """How far the render of a film has come. The film's sums lie beside it in a file (`checkpoint_file`).

    identity : Identity
    state : LoopState
    seed : int, that its samples are made of
    learned : LearnedField or None, what guides by then
    """

    identity: Identity
    state: LoopState
    seed: int = 0
    learned: LearnedField | None = None
