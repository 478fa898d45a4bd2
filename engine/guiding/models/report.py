# SPDX-License-Identifier: GPL-3.0-or-later
"""What guiding did in a render, for logs and benchmarks, and in words for people."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

from engine.methods import METHODS

#: Efficiency from which its first decimal says that guiding paid.
_PAYS_FROM = 1.05


@dataclass
class GuidingReport:
    """What guiding did; times in seconds of all threads together."""

    method: str = "OFF"
    field_seconds: float = 0.0
    training_seconds: float = 0.0
    region_count: int = 0
    lobe_count: float = 0.0
    record_count: int = 0
    #: Regions that began anew, since what they had learned was no density.
    unsound_count: int = 0
    network_loss: float = float("nan")
    network_step: int = 0
    snapshot_count: int = 0
    has_trained: bool = False
    #: The network is trained only where the render is long enough, and kept where held-out records say that it pays.
    is_network_gated: bool = False
    #: Efficiency that they last promised with the network, over that without.
    network_promise: float = float("nan")
    #: The sample from which on the network was given up, 0: never.
    network_stopped_at: int = 0
    candidates_per_vertex: float = 0.0
    worker: str = ""
    #: By what the radiance network was asked at the end, and what that was chosen by.
    network_backend: str = ""
    #: What directions are drawn from, if not the mixture field.
    source: str = ""
    source_seconds: float = 0.0
    #: The sample from which on a network as the source was given up, 0: never.
    source_stopped_at: int = 0
    #: Efficiency over unguided rendering when last compared; the sample from which on guiding was given up, 0: never.
    efficiency: float = float("nan")
    stopped_at: int = 0
    #: What the render started from, '' if from nothing.
    started_from: str = ""
    #: What it could have started from, but guiding did not pay there; '' if there was nothing of the kind.
    lost_before: str = ""
    #: The method in use at the end, and why (`engine.guiding.policy.questions.method`).
    chosen: str = ""
    trials: list[str] = field(default_factory=list)
    #: Share of the regions that are guided.
    guided_share: float = float("nan")
    #: The same of media; NaN where there are none.
    guided_media_share: float = float("nan")
    #: What is guided in scenes with media (`engine.guiding.policy.questions.media`), '' without.
    guides: str = ""
    #: Share of the regions that sample the lights that they have learned to see; NaN: there is nothing to choose.
    lights_share: float = float("nan")

    #: What the image still lacks that the radiance cache did not know, relative to a pixel, root of the mean
    #: square, as estimated; NaN where it is not measured. The sample from which on the cache was given up, 0:
    #: never.
    cache_bias: float = float("nan")
    cache_stopped_at: int = 0

    lines: list[str] = field(default_factory=list)
    #: What guiding came to, for those who render rather than measure; '' where nothing was guided.
    sentence: str = ""
    #: The same of the radiance cache; '' where there was none, and nobody left the choice to the render.
    cache_sentence: str = ""

    def describe_left_out(self) -> None:
        """Write that a method which compares did not begin, since the render is over before it could pay."""
        self.chosen = "OFF"
        self.lines = ["chose to render without guiding: so few samples are over before it could pay"]
        self.sentence = "Rendered without guiding: so few samples are over before it could pay"

    def describe_cache(self, cached_shares: Sequence[float]) -> None:
        """Add a line on the radiance cache, in which these shares of the paths ended: after one scattering, after two,
        later.
        """
        line = f"radiance cache: {sum(cached_shares):.0%} of the paths came to where they could end in it"
        where = ""
        if any(cached_shares):
            first, second, later = cached_shares
            where = f" ({first:.0%} after one scattering, {second:.0%} after two, {later:.0%} later)"
        line += where
        if self.cache_stopped_at:
            line += f"; given up after {self.cache_stopped_at} samples, since it made more error than paths without it"
            self.cache_sentence = (
                f"Ending paths in learned light did not pay here: from sample {self.cache_stopped_at + 1} on paths "
                "find all light themselves"
            )
        elif math.isfinite(self.cache_bias):
            line += f"; pixels are off by about {self.cache_bias:.1%} that it did not know"
            self.cache_sentence = (
                f"{sum(cached_shares):.0%} of the paths could end in learned light{where}, and some went on to measure "
                f"what that lacks. Single pixels are still off by about {self.cache_bias:.1%} through it, their mean "
                "is not, and that vanishes with more samples. Unbiased renders have none of it, and more noise"
            )
        elif any(cached_shares):
            self.cache_sentence = (
                f"{sum(cached_shares):.0%} of the paths ended in learned light{where}. What that lacks is missing"
            )
        self.lines.append(line)

    def describe_no_cache(self, reason: str) -> None:
        """Say why no path could end in a radiance cache, where that was left to the render; '': it was not."""
        if not reason:
            return
        self.cache_sentence = f"Paths found all light themselves, without a cache of learned light: {reason}"
        self.lines.append(f"radiance cache: not used, {reason}")

    def describe(self, stage_seconds: dict[str, float]) -> None:
        """Write `lines` for who measures and `sentence` for all others, given the tracing threads' time by stage."""
        tracing = sum(stage_seconds.values())
        training = self.training_seconds + self.source_seconds
        everything = max(tracing + self.field_seconds + training, 1e-9)
        inference = stage_seconds.get("predict_radiance", 0.0)
        self.lines = [
            f"guiding {self.method}: {(tracing - inference) / everything:.0%} of the time tracing, "
            f"{self.field_seconds / everything:.0%} fitting, {inference / everything:.0%} predicting, "
            f"{training / everything:.0%} training; {self.candidates_per_vertex:.2f} candidates a vertex, "
            f"{self.region_count} regions of {self.lobe_count:.1f} lobes, {self.record_count} records"
        ]
        if self.started_from:
            self.lines.append(f"started from what earlier renders had learned: {self.started_from}")
        if self.lost_before:
            self.lines.append(f"guiding did not pay in earlier renders ({self.lost_before}): learned anew")
        self.sentence = self._verdict()
        if METHODS[self.method].rungs:
            self.lines.append(self._choice())
        elif self.stopped_at:
            share = f"{self.efficiency:.2f} of the efficiency without"
            reason = share if self.efficiency > 0.0 else "its samples were of no use"
            self.lines.append(
                f"guiding did not pay here ({reason}): samples from {self.stopped_at + 1} on are not guided"
            )
        if self.unsound_count:
            self.lines.append(f"{self.unsound_count} regions began anew: what they had learned was no density")
        if self.guides and not self.stopped_at:
            is_known = not self.guides.startswith("surfaces alone") and not math.isnan(self.guided_media_share)
            of_media = f"; collisions in {self.guided_media_share:.0%} of the regions" if is_known else ""
            self.lines.append(f"guided: {self.guides}{of_media}")
        if self.trials:
            self.lines.append("compared: " + "; ".join(self.trials))
        if not math.isnan(self.lights_share):
            self.lines.append(
                f"lights: {self.lights_share:.0%} of the regions sample those that they have learned to see"
            )
        if self.source:
            self.lines.append(self.source)
        if self.source_stopped_at:
            self.lines.append(
                f"the network did not pay here: from sample {self.source_stopped_at + 1} on directions come from the "
                "mixture field"
            )
        if self.worker:
            self.lines.append(
                f"radiance network: {self.snapshot_count} snapshots, {self.network_step} steps, "
                f"loss {self.network_loss:.3g}, worker {self.worker}"
            )
        if self.network_backend:
            self.lines.append(f"radiance network: asked by {self.network_backend}")
        if self.is_network_gated and not self.stopped_at and not METHODS[self.method].rungs and not self.has_trained:
            self.lines.append("radiance network: not trained, too little of the render was left to pay for that")
        if self.network_stopped_at:
            promise = "" if math.isnan(self.network_promise) else f" ({self.network_promise:.2f} of what it is without)"
            self.lines.append(
                f"radiance network: held-out records did not promise enough efficiency{promise}; it was given up at "
                f"sample {self.network_stopped_at + 1}"
            )
        elif not math.isnan(self.network_promise):
            self.lines.append(
                f"radiance network: held-out records promised {self.network_promise:.2f} of the efficiency without it"
            )

    def _verdict(self) -> str:
        """What guiding came to. Noise is variance in equal time, which is what efficiency compares."""
        if self.method == "OFF":
            return ""
        if self.stopped_at:
            return f"Guiding did not pay here and was switched off after {self.stopped_at} samples"
        if math.isnan(self.efficiency):
            return "Guiding was on, and was not compared with going without"
        if self.efficiency >= _PAYS_FROM:
            return f"Guiding paid: {self.efficiency:.1f} times less noise than without"
        return "Guiding made no difference: about as much noise as without"

    def _choice(self) -> str:
        """What was chosen, where and why, in a line."""
        compared = "" if math.isnan(self.efficiency) else f", {self.efficiency:.2f} times as efficient"
        if self.stopped_at:
            reason = f"it was{compared[1:]} as going without" if self.efficiency > 0.0 else "its samples were of no use"
            return f"chose to render without guiding from sample {self.stopped_at + 1} on: {reason}"
        where = "" if math.isnan(self.guided_share) else f" in {self.guided_share:.0%} of the regions"
        return f"chose {METHODS[self.chosen].words}{where}{compared + ' as without' if compared else ''}"
