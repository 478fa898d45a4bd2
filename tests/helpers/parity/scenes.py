# SPDX-License-Identifier: GPL-3.0-or-later
"""Which of the built-in scenes are compared with Cycles, and how each comparison is rendered."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.images import Float32Array
from benchmarks.rendering import image_stack, render_scene
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import SceneSource
from benchmarks.scenes import SCENES

PIXELS = 48 * 36

#: Few scenes that touch much: closures, textures, lights, world, camera, instances, alpha.
FAST = (
    "principled-everything", "glass-rough", "textured", "light-spot-blend", "light-area-disk", "emissive-textured",
    "world-image-sun", "camera-depth-of-field-blades", "camera-panorama-range", "instanced", "modifiers",
    "film-transparent",
)  # fmt: skip

#: Where light is made to be found seldom, unguided samples say nothing in a test's time: the study's lamps are all
#: hidden. Cycles disperses nothing. Furnished rooms take minutes, and so do most media made to fail. Of boundaries in
#: one place Cycles loses some, and its light samples of sheared lamps are none of what its rays find
#: (docs/differences.md). Linked lights in media take a minute to compile, and have a
#: comparison of their own.
_LEFT_OUT = (
    "torus-in-glass", "weathered-rooms", "study", "evening-room-fog", "linked-rooms", "lamp-sheared"
)  # fmt: skip
_GROUPS_LEFT_OUT = ("failures", "spectral", "furnished", "caustics", "clamped", "matter_indoors", "matter_large")
LINKED_MEDIA = ("linked-fog", *sorted(name for name, scene in SCENES.items() if scene.group == "linked_media"))
_QUICK = ("forward", "backward", "thin", "huge", "colors")
COMPARABLE = tuple(
    sorted(
        name
        for name, scene in SCENES.items()
        if scene.group not in _GROUPS_LEFT_OUT
        and name not in (*_LEFT_OUT, *LINKED_MEDIA)
        and (scene.group != "failing_media" or name.removeprefix("fail-fog-") in _QUICK)
        or name == "spectral-colors"
    )
)
#: Rooms of whose light the clamp takes much: two thousand pixels are so noisy that denoising moves light between cells.
CLAMPED = tuple(sorted(name for name, scene in SCENES.items() if scene.group == "clamped"))


@dataclass(frozen=True)
class Comparison:
    """Scenes that are compared in one way.

    Attributes
    ----------
    samples : int
        Samples of each pixel; 0: `sample_factor` times those that compare a scene well.
    at_defaults : bool
        Whether the settings of light paths are Blender's own, instead of those that cut nothing.
    noise_threshold : float
        0: each pixel has all samples.
    is_denoised : bool
    """

    name: str
    scenes: tuple[str, ...]
    samples: int = 0
    sample_factor: int = 1
    at_defaults: bool = False
    noise_threshold: float = 0.0
    is_denoised: bool = False

    def samples_of(self, scene: str) -> int:
        """Samples of each pixel of a scene."""
        return self.samples or self.sample_factor * SCENES[scene].samples

    def render(self, scene: str, renderer: str, seeds: int, out: Path, *, first_seed: int = 1) -> list[Float32Array]:
        """Pictures of a renderer, one a seed."""
        rival = find_rival(f"{renderer}+oidn" if self.is_denoised else renderer)
        budget = Budget(self.samples_of(scene), noise_threshold=self.noise_threshold)
        renders, failures = render_scene(
            SceneSource(f"builtin:{scene}"), [rival], budget, seeds, out=out, pixels=PIXELS,
            at_defaults=self.at_defaults, first_seed=first_seed, say=lambda _: None,
        )  # fmt: skip
        assert not failures
        images = image_stack(renders[rival.name])
        assert all(np.isfinite(image).all() for image in images)
        return images


#: Without clamps and denoising, where Cycles and we have the same mean by right.
PLAIN = Comparison("plain", COMPARABLE, sample_factor=4)
#: As Blender's users render: clamp, noise threshold, Filter Glossy, Light Threshold and denoising as Blender has them.
AT_DEFAULTS = Comparison("defaults", COMPARABLE, samples=64, at_defaults=True, noise_threshold=0.01, is_denoised=True)
#: The same with samples enough for the noise threshold to stop pixels, from 160 on by Cycles' rule. Not denoised: of so
#: many samples ours is mixed with them, and has their mean, which Cycles' denoised pictures miss by up to 1%.
STOPPED = Comparison("stopped", FAST, samples=320, at_defaults=True, noise_threshold=0.01)
CLAMPED_ROOMS = Comparison("clamped", CLAMPED, at_defaults=True)
LINKED = Comparison("linked", LINKED_MEDIA, sample_factor=4)
COMPARISONS = (PLAIN, AT_DEFAULTS, STOPPED, CLAMPED_ROOMS, LINKED)
