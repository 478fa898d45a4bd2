# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render says of itself: while it goes on, and at its end."""

from __future__ import annotations

import sys
from collections.abc import MutableMapping
from dataclasses import dataclass, field

import numpy as np

from engine.guiding.models.report import GuidingReport
from engine.guiding.policy.guidance import Guidance
from engine.guiding.saved.learned import LearnedField
from engine.scene.description import Notice

try:
    import resource
except ImportError:  # Windows
    resource = None  # type: ignore[assignment]


#: What ends a render, and how that is said.
ENDINGS = {
    "SAMPLES": "All samples taken",
    "NOISE_THRESHOLD": "Noise threshold reached",
    "DENOISED_THRESHOLD": "Denoised picture good enough",
    "TIME_LIMIT": "Time limit reached",
    "CANCEL": "Cancelled",
}


@dataclass(frozen=True)
class Progress:
    """Where a render stands. `remaining` is in seconds, None while unknown.

    While kernels are compiled ahead `fraction` is of that; the render then begins at 0.
    `noisy_share` is the share of the pixels that a noise threshold has left, None without one, or while nobody has
    looked.
    """

    fraction: float
    sample: int
    samples: int
    elapsed: float
    remaining: float | None
    rays_per_second: float
    message: str
    noisy_share: float | None = None


@dataclass
class RenderReport:
    """What happened, for logs and benchmarks; times in seconds, memory in bytes."""

    notices: list[Notice] = field(default_factory=list)
    build_seconds: float = 0.0
    compile_seconds: float = 0.0  # kernels, the first time ever
    prepare_seconds: float = 0.0  # kernels: loading those that were compiled before
    kernels: str = ""  # where all of this process came from
    render_seconds: float = 0.0
    denoise_seconds: float = 0.0  # after the render's end, not part of `render_seconds`
    #: Error of the denoised picture as it was last estimated, of display values, and at which sample; None: never.
    denoised_error: float | None = None
    denoised_look: int = 0
    sample_count: float = 0.0  # mean per pixel
    path_count: int = 0
    rays: dict[str, int] = field(default_factory=dict)
    stage_seconds: dict[str, float] = field(default_factory=dict)  # summed over threads
    reject_count: int = 0  # samples that were not finite: black in the picture
    record_reject_count: int = 0  # records that were not finite: nothing is learned from them
    record_drop_count: int = 0  # records of units whose paths left more than there is room for
    peak_memory: int = 0
    thread_count: int = 1
    #: Shares of the paths that ended in the radiance cache, or could have: after one scattering, after two, later.
    cached_shares: tuple[float, ...] = ()
    is_spectral: bool = False  # paths had wavelengths
    ended_by: str = "SAMPLES"  # of ENDINGS
    guiding: GuidingReport = field(default_factory=GuidingReport)

    @property
    def cancelled(self) -> bool:
        """Whether a user has ended the render."""
        return self.ended_by == "CANCEL"

    @property
    def denoised_sentence(self) -> str:
        """What was estimated of the denoised picture, '' where nothing was."""
        if self.denoised_error is None:
            return ""
        stopped = "stopped" if self.ended_by == "DENOISED_THRESHOLD" else "last looked"
        return f"denoised picture: {stopped} at sample {self.denoised_look}, error about {self.denoised_error:.2g}"


@dataclass
class RenderResult:
    """passes : mapping of name to float32 (height, width, channels), row 0 at the bottom.

    guidance : Guidance or None
        What the last iteration went by; None of an unguided render.
    learned : LearnedField or None
        What others can start from; None where that was not asked for, or nothing was learned.
    """

    passes: MutableMapping[str, np.ndarray]
    report: RenderReport
    guidance: Guidance | None = None
    learned: LearnedField | None = None


def peak_memory() -> int:
    """Largest resident memory of this process so far [bytes]; 0 where the system does not tell."""
    if resource is None:
        return 0
    usage = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return usage if sys.platform == "darwin" else usage * 1024
