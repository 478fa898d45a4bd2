# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a field still fits an edited scene is measured; whatever comes of it, the mean of the picture is right."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from engine.guiding.saved.judge import LEAST_RECORDS, FieldJudge, information_gain
from engine.guiding.saved.learned import LearnedField
from engine.render.session import Session
from engine.scene.description import SceneDescription
from engine.settings import RenderSettings
from tests.helpers.learned_fields import random_records
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import floor_scene, material

SETTINGS = RenderSettings(
    samples=31, seed=1, guiding_method="VMM", max_bounces=4, threads=1, guiding_trial=False, use_nee=False,
    use_russian_roulette=False,
)  # fmt: skip


def lit_floor(x: float, color: tuple[float, float, float] = (0.7, 0.7, 0.7), glow: float = 60.0) -> SceneDescription:
    """A floor under a small bright square at x [m], which only scattered rays find, and a dim wide one."""
    squares = [
        np.array([[0.01, 0, 0, x], [0, 0.01, 0, 0], [0, 0, 0.01, 1.0], [0, 0, 0, 1]], np.float32),
        np.array([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 40.0], [0, 0, 0, 1]], np.float32),
    ]
    description = floor_scene(
        materials=[
            material(color=color), material("Glow", (glow, glow, glow), "ShaderNodeEmission"),
            material("Dim", (0.05, 0.05, 0.05), "ShaderNodeEmission"),
        ],
        transforms=[np.eye(4, dtype=np.float32), *squares], size=(64, 64),
    )  # fmt: skip
    instances = description.instances
    instances.material_offset, instances.materials = np.array([0, 1, 2], np.int32), np.array([0, 1, 2], np.int32)
    # The camera looks through the squares.
    instances.visibility[1:] &= ~np.uint32(1)
    return description


@pytest.fixture(scope="module")
def session() -> Any:
    made = Session(SETTINGS)
    yield made
    made.close()


@pytest.fixture(scope="module")
def learned(session: Session) -> LearnedField:
    """What a render has learned of light from the left."""
    session.load(lit_floor(-1.5))
    field = session.render(keep=True).learned
    assert field is not None
    return field


def judged(session: Session, learned: LearnedField, description: SceneDescription) -> FieldJudge:
    session.load(description)
    judge = FieldJudge(learned, session.light_digest)
    session.render(samples=1, start=judge.field, sink=judge)
    return judge


@pytest.mark.parametrize("edit", [{"color": (0.7, 0.2, 0.1)}, {"glow": 200.0}, {"glow": 20.0}])
def test_a_field_outlives_edits_that_leave_light_where_it_was(
    edit: dict[str, Any], session: Session, learned: LearnedField
) -> None:
    judge = judged(session, learned, lit_floor(-1.5, **edit))
    assert judge.is_sure and judge.gain > 0.2
    kept = judge.kept
    assert kept is not None and kept.light_digest == session.light_digest
    assert kept.seed(1) not in (learned.seed(1), judge.field.seed(1)), "the same samples as it was judged by"
    result = session.render(start=kept)
    assert result.report.notices == [] and result.report.guiding.started_from == str(kept)


def test_a_field_is_dropped_where_light_comes_from_elsewhere(session: Session, learned: LearnedField) -> None:
    judge = judged(session, learned, lit_floor(1.5))
    assert judge.is_sure and judge.gain < 0.0
    assert judge.kept is None


def test_few_records_say_nothing(session: Session, learned: LearnedField) -> None:
    judge = FieldJudge(learned, "another scene")
    assert judge.kept is None and np.isnan(judge.gain)
    judge.take(random_records(0, LEAST_RECORDS // 2), LEAST_RECORDS // 2)
    assert not judge.is_sure and judge.kept is None


def test_the_gain_is_what_it_says() -> None:
    """Guides that are twice and half as sure of half of the light each, and vertices that were not guided."""
    records = random_records(0, 4000)
    records.bsdf_pdf[:] = 0.1
    records.guide_pdf[:2000], records.guide_pdf[2000:] = 0.2, 0.05
    records.contribution_squared[:] = 1.0
    expected = 0.5 * (np.log(1.5) + np.log(0.75))
    assert information_gain(records, 4000) == pytest.approx(expected, rel=1e-6)
    records.guide_pdf[2000:] = np.nan
    assert information_gain(records, 4000) == pytest.approx(np.log(1.5), rel=1e-6)
    # No single record decides.
    records.guide_pdf[0], records.contribution_squared[0] = 0.0, 1e20
    assert information_gain(records, 4000) == pytest.approx(np.log(1.5), abs=5e-3)
    records.contribution_squared[:] = 0.0
    assert np.isnan(information_gain(records, 4000))


def test_any_field_leaves_the_mean_as_it_is(session: Session, learned: LearnedField) -> None:
    """Guided by a field that fits not at all, which learns on. Z-test at four standard errors, fixed seeds."""
    description = lit_floor(1.5)
    session.load(description)
    start = learned.of_scene(session.light_digest)
    means: dict[str, list[float]] = {"started": [], "plain": []}
    for seed in range(8):
        session.settings = replace(SETTINGS, seed=seed, samples=15)
        means["started"].append(session.render(start=start).passes["Combined"][..., :3].mean())
        session.settings = replace(session.settings, guiding_method="OFF", samples=60)
        means["plain"].append(session.render().passes["Combined"][..., :3].mean())
    session.settings = SETTINGS
    started, plain = np.array(means["started"]), np.array(means["plain"])
    assert z_score(started, plain) < Z_LIMIT
