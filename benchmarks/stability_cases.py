# SPDX-License-Identifier: GPL-3.0-or-later
"""The cases of the stability suite: a scene of `benchmarks/scenes/` that is called `fail-...`, a size, samples."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from benchmarks.patterns import matching
from benchmarks.rivals import Budget, find_rival
from benchmarks.scene_files import BUILTIN, SceneSource, open_scene
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings

PREFIX = "fail-"


@dataclass(frozen=True)
class Case:
    """One way to fail.

    Attributes
    ----------
    scene : str
        A built-in scene.
    samples : int
        Samples per pixel of a render; with `seeds` enough to see a bias of 2% (`tests/benchmarks/test_stability.py`).
    seeds : int
        Renders of a statistical method that takes.
    size : (width, height) or None
        None: the scene's own.
    earlier_sizes : sequence of (width, height)
        Rendered before in the same session.
    settings : mapping
        Of `RenderSettings`, that are not the scene's.
    text : str
        What it is for, if that is not what the scene is for.
    """

    name: str
    scene: str
    samples: int = 63
    seeds: int = 4
    size: tuple[int, int] | None = None
    earlier_sizes: Sequence[tuple[int, int]] = ()
    settings: Mapping[str, Any] = field(default_factory=dict, hash=False)
    text: str = ""

    @property
    def purpose(self) -> str:
        """What it is for, in a sentence."""
        from benchmarks.scenes import SCENES

        return self.text or SCENES[self.scene].description


def _few(samples: int, size: tuple[int, int]) -> Case:
    text = f"Pictures of {samples} sample{'s' if samples > 1 else ''} a pixel: hardly anything can have been learned"
    return Case(f"few-{samples}", "fail-scale-1", samples, size=size, text=text)


#: Scenes of `benchmarks/scenes/failing_media.py`.
FOGS = (
    "door", "forward", "backward", "thin", "dense", "albedo", "colors", "lamp", "glass", "coplanar", "boundary",
    "huge", "speck", "shreds",
)  # fmt: skip

#: In the order of the issues' lists.
CASES: dict[str, Case] = {
    case.name: case
    for case in (
        Case("parallax", "fail-parallax"),
        Case("thin", "fail-thin"),
        Case("keyhole", "fail-keyhole", 127, 6),
        Case("dark-bright", "fail-dark-bright"),
        *(Case(f"roughness-{r}", f"fail-roughness-{r}") for r in ("0", "0.01", "0.03", "0.1", "0.3")),
        Case("late-caustic", "fail-late-caustic"),
        Case("fireflies", "fail-fireflies"),
        Case("colors", "fail-colors"),
        Case("many-lights", "fail-many-lights"),
        Case("ten-rooms", "fail-ten-rooms"),
        Case("street", "fail-street"),
        Case("texel", "fail-texel"),
        *(Case(f"scale-{s}", f"fail-scale-{s}") for s in ("1e-4", "1", "1e6")),
        Case("offset-1e4", "fail-offset-1e4"),
        Case("coplanar", "fail-plane"),
        Case("alpha-fog", "fail-alpha-fog", 31),
        Case("albedo", "fail-albedo", size=(24, 18), settings={"max_bounces": 16, "diffuse_bounces": 16},
             text="Walls that reflect 99.9% of the light, for sixteen bounces: each enters the weight of a path"),
        Case("albedo-100", "fail-albedo", size=(24, 18)),
        _few(1, (192, 144)),
        _few(2, (160, 120)),
        _few(4, (128, 96)),
        _few(8, (96, 72)),
        Case(
            "long", "fail-dark-bright", 2047, size=(12, 9),
            text="Two thousand samples a pixel: 131 iterations of learning from what was learned before",
        ),
        Case(
            "resolution", "fail-colors", size=(48, 36), earlier_sizes=((9, 7), (64, 20)),
            text="The size changes within a session: nothing of an earlier picture may stay in what is learned",
        ),
        *(Case(f"fog-{name}", f"fail-fog-{name}") for name in FOGS),
        # Rays cross 128 boundaries, and each of their segments sends a shadow ray through what is left of them.
        Case("fog-nested", "fail-fog-nested", 15, size=(32, 24)),
    )
}  # fmt: skip


def find_cases(patterns: Sequence[str]) -> list[Case]:
    """Cases by name or pattern, all without any.

    Raises
    ------
    ValueError
        Naming those there are.
    """
    return [CASES[name] for name in matching(CASES, [text.removeprefix(PREFIX) for text in patterns], "case")]


def describe_case(case: Case, threads: int = 0) -> tuple[SceneDescription, RenderSettings]:
    """Build a case's scene in this process and export it, with the settings of an unguided render of it.

    Parameters
    ----------
    threads : int
        0 = all cores.
    """
    import bpy

    from addon.export import export_scene
    from addon.properties import render_settings

    scene = open_scene(SceneSource(BUILTIN + case.scene), size=case.size)
    find_rival("OFF").configure(scene, Budget(case.samples), 1, threads or 1)
    settings = replace(render_settings(scene), threads=threads, **case.settings)
    return export_scene(bpy.context.evaluated_depsgraph_get()), settings


def resized(description: SceneDescription, size: tuple[int, int]) -> SceneDescription:
    """The same scene at another size."""
    frame = replace(description.frame, width=size[0], height=size[1], region=(0, 0, *size))
    return replace(description, frame=frame)
