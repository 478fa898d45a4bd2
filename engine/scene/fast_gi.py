# SPDX-License-Identifier: GPL-3.0-or-later
"""Fast GI Approximation: what stands for the light of later bounces."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class FastGi:
    """What is done for later bounces, and by how much.

    How far rays look is `PassSettings.occlusion_distance`, or `Instances.occlusion_distance` of what they leave.

    Attributes
    ----------
    bounces : int
        Rays that were scattered so often or more are short: they see the background beyond what is near, and paths end
        where they arrive; 0 = none are. Transmissions do not count, and of glossy reflections one does not.
    background : float
        Share of the background that short rays see.
    added : float
        Radiance that diffuse surfaces receive, at every bounce, from where nothing near hides the sky.
    """

    bounces: int = 0
    background: float = 1.0
    added: float = 0.0

    @property
    def is_used(self) -> bool:
        """Whether anything is done."""
        return self.bounces > 0 or self.added != 0.0
