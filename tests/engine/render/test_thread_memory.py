# SPDX-License-Identifier: GPL-3.0-or-later
"""A thread's memory is used again for every unit and every render: nothing of what it has left may show."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
import pytest

from engine.render.batch import Batch
from engine.render.session import Session
from engine.runtime.bundle import Bundle
from engine.settings import RenderSettings
from engine.wavefront.work import QUEUES
from tests.helpers.media_renders import picture
from tests.helpers.media_scenes import media_scene, medium, placed, varying

#: What `Batch.begin` sets, what a render sets once, and what has no part in the picture.
SET_BEFORE = {
    "counts", "clock", "ray", "ray_bits", "ray_address", "registers.floats", "free.lanes", *(f"{name}.count" for name in QUEUES),
    "guided.rough_share", "samples.guide_pdf", "samples.bsdf_share", "samples.weight", "samples.cluster",
    "closures.aovs", "shaded.aovs", "media.is_lit", "media.collision_share",
}  # fmt: skip


def arrays(bundle: Bundle, prefix: str = "") -> Iterator[tuple[str, np.ndarray]]:
    """All arrays of a bundle by name, and those of bundles in it."""
    for name in bundle._fields:
        value = getattr(bundle, name)
        if isinstance(value, Bundle):
            yield from arrays(value, f"{prefix}{name}.")
        elif isinstance(value, np.ndarray):
            yield prefix + name, value


def fill(batch: Batch, real: float, whole: int) -> None:
    """Leave something in all of a thread's memory that a unit has to set before it reads it."""
    for name, array in arrays(batch.work):
        if name not in SET_BEFORE:
            array[...] = real if array.dtype.kind == "f" else whole
    if batch.guidance is not None and hasattr(batch.guidance.guide, "lobes"):
        for _, array in arrays(batch.guidance.guide):
            array[...] = real if array.dtype.kind == "f" else whole


def fog(varies: bool):
    """Fog over a floor under an even sky."""
    kind = {"Color": (0.9, 0.8, 0.7, 1.0), "Anisotropy": 0.3}
    inside = varying("Scatter", "Density", 2.0, **kind) if varies else medium("Scatter", Density=1.0, **kind)
    floor = medium("Absorption", "ShaderNodeBsdfDiffuse", name="Floor", Density=0.0)
    return media_scene([inside, floor], [placed(), placed((4.0, 4.0, 0.5), (0.0, 0.0, -1.6))], size=(40, 36))


@pytest.mark.parametrize("varies", [False, True])
@pytest.mark.parametrize(
    "method",
    ["OFF", "TABLE_RIS", *(pytest.param(method, marks=pytest.mark.slow) for method in ("VMM", "VMM_RIS", "SDTREE"))],
)
def test_nothing_shows_of_what_earlier_units_have_left(method: str, varies: bool, monkeypatch: pytest.MonkeyPatch):
    settings = {"guiding_method": method, "samples": 15, "guiding_trial": False, "seed": 1}
    expected = picture(fog(varies), **settings)
    begin = Batch.begin
    for real, whole in ((np.nan, 0), (1e20, 1), (-0.37, 1)):

        def begin_with(batch: Batch, real: float = real, whole: int = whole) -> None:
            fill(batch, real, whole)
            begin(batch)

        monkeypatch.setattr(Batch, "begin", begin_with)
        assert np.array_equal(picture(fog(varies), **settings), expected)


def test_a_scene_after_one_of_dense_media_is_rendered_as_if_it_were_the_first():
    """Nothing of the first scene's media is left in the next."""
    settings = {"guiding_method": "OFF", "samples": 4, "threads": 1, "filter_glossy": 0.0}
    dense, thin = (
        media_scene([medium("Scatter", Density=density, Color=(0.9, 0.9, 0.9, 1.0))], [placed()], size=(24, 24))
        for density in (1e6, 1.0)
    )
    session = Session(RenderSettings(**settings))
    for scene in (dense, thin):
        session.load(scene)
        after = session.render(passes=("Combined",)).passes["Combined"][..., :3]
    session.close()
    assert np.array_equal(after, picture(thin, **settings))
