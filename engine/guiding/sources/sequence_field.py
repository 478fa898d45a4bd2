# SPDX-License-Identifier: GPL-3.0-or-later
"""A neural mixture that knows a span of many frames: trained once, every frame is rendered by it.

To the network, u is the time in the span, from the opening of the first frame's shutter to the closing of the last
one's. A path's own time, which goes over one shutter, is mapped to the part of the span that its frame is.

References
----------
Dong et al. 2024, "Efficient Neural Path Guiding with 4D Modeling", section 6.2 ("Rendering Animated Sequences").
"""

from __future__ import annotations

from dataclasses import dataclass, replace

from engine.guiding.models.source_model import TrainedSource
from engine.guiding.networks.mixture.inference import make_mixture_network
from engine.guiding.networks.mixture.shape import MixtureShape, selection_blend
from engine.guiding.networks.radiance import Snapshot
from engine.guiding.sources import network_design
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings


def with_sequence_u(settings: RenderSettings, u_dimension: str) -> RenderSettings:
    """Settings for a network that was or will be trained before a frame is rendered: 'TIME' as u, or 'NONE'."""
    # Nothing is trained within a frame that strata could help with.
    return replace(settings.with_u(u_dimension), strata=0)


def u_span(description: SceneDescription, span: tuple[float, float]) -> tuple[float, float]:
    """u at the opening and the closing of a frame's shutter, each in [0, 1].

    Parameters
    ----------
    span : (float, float) [frames]
        What u goes over; the second is the later one.
    """
    first, last = span
    times = description.shutter or (description.frame_current, description.frame_current)
    opening, closing = (min(max((time - first) / (last - first), 0.0), 1.0) for time in times)
    return opening, closing


@dataclass(frozen=True)
class SequenceField:
    """What was learned of a sequence; immutable, for any number of frames at the same time.

    span : (float, float) [frames], what u goes over
    u_dimension : 'TIME', or 'NONE' where the network tells no frame from the other
    shape : MixtureShape
    snapshot : Snapshot
    samples : samples a pixel that it was trained on, of all frames together
    frame_count : frames that these were of
    """

    span: tuple[float, float]
    u_dimension: str
    shape: MixtureShape
    snapshot: Snapshot
    samples: float
    frame_count: int

    def source(self, settings: RenderSettings, description: SceneDescription) -> TrainedSource:
        """What to render a frame by (`Session.render`).

        Raises
        ------
        ValueError
            If the settings ask for another network.
        """
        if network_design(with_sequence_u(settings, self.u_dimension)).shape != self.shape:
            raise ValueError(f"the sequence's field is no {settings.source} of these settings: train it anew")
        network = make_mixture_network(
            self.shape, self.snapshot, selection_blend(self.samples), u_span(description, self.span)
        )
        return TrainedSource(network, self.u_dimension, f"{settings.source}: {self}")

    def __str__(self) -> str:
        return (
            f"trained once for times {self.span[0]:g} to {self.span[1]:g}, on {self.frame_count} frames, "
            f"{self.samples:g} samples a pixel in all, {self.snapshot.step} steps, loss {self.snapshot.loss:.3g}"
        )
