# SPDX-License-Identifier: GPL-3.0-or-later
"""What was learned outlives a render: it comes back whole, later renders go on with it, and their mean is right."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from engine.builder.scene import SceneCache, build_scene
from engine.guiding.fields.state import StateError, part
from engine.guiding.fields.table import TableModel
from engine.guiding.fields.vmm.field import (
    LOBE_COEFFICIENT,
    LOBE_INVERSE_DISTANCE,
    LOBE_KAPPA,
    LOBE_WEIGHT,
    LOBE_X,
    LOBE_Z,
    MAX_LOBES,
)
from engine.guiding.models.record_sink import RowSink
from engine.guiding.models.regions import RegionModels
from engine.guiding.policy.guidance import Guidance
from engine.guiding.policy.iterations import iteration_weight
from engine.guiding.policy.request import LearningRequest
from engine.guiding.policy.sets import make_learner
from engine.guiding.records.training_rows import ROW_PDF, ROW_RADIANCE, ROW_WI
from engine.guiding.saved.learned import LOST, OPEN, WON, LearnedField
from engine.render.session import Session
from engine.render.tracer import Tracer
from engine.ris.orca import Allocation
from engine.scene.description import Camera, SceneDescription
from engine.settings import RenderSettings
from tests.helpers.learned_fields import learned_field, learned_models, random_records
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import corner_scene, floor_scene, looking_down, material, pit_scene

GUIDED = {"guiding_method": "VMM", "max_bounces": 6, "threads": 1, "guiding_trial": False}


@pytest.fixture
def session() -> Iterator[Session]:
    """A session with the pit, rendered by mixtures."""
    made = Session(RenderSettings(samples=15, seed=1, **GUIDED))
    made.load(pit_scene())
    yield made
    made.close()


def image(result: Any) -> np.ndarray:
    return result.passes["Combined"][..., :3]


# ---------------------------------------------------------------------------------------------------------------------
# The state


def test_a_state_comes_back_and_goes_on_learning_as_the_first_would() -> None:
    regions, table = learned_models(0)
    again = RegionModels.of_state(regions.state(), 0.5)
    table_again = TableModel.of_state(table.state(), regions.mixture.region_count, 3)
    for _ in range(2):
        for name, array in regions.field._asdict().items():
            np.testing.assert_array_equal(getattr(again.field, name), array, strict=True, err_msg=name)
        np.testing.assert_array_equal(table_again.field.values, table.field.values)
        np.testing.assert_array_equal(again.variance_deltas(), regions.variance_deltas())
        first, second = regions.state(), again.state()
        assert list(first) == list(second)
        for name, array in first.items():
            np.testing.assert_array_equal(second[name], array, strict=True, err_msg=name)
        for models, tables in ((regions, table), (again, table_again)):
            records = random_records(99)
            models.fit(records, len(records.pdf))
            tables.update(models.mixture)
            models.add_deltas(records, len(records.pdf))
            models.learn_shares(records, len(records.pdf), variance=1.0, ray_count=4.0, was_guided=True)


def test_a_state_is_a_copy() -> None:
    regions, _ = learned_models(0)
    before = regions.field.lobes.copy()
    for array in regions.state().values():
        array.fill(0)
    records = random_records(99)
    regions.fit(records, len(records.pdf))
    again, _ = learned_models(0)
    np.testing.assert_array_equal(before, again.field.lobes)
    again.fit(random_records(99), len(records.pdf))
    np.testing.assert_array_equal(regions.field.lobes, again.field.lobes)


@pytest.mark.parametrize(("name", "change", "message"), [
    ("mixture.lobes", lambda array: array[:-1], "lobes has the shape"),
    ("mixture.lobes", lambda array: array.astype(np.float64), "lobes has numbers of the type float64"),
    ("light_share.share", lambda array: 0.0 * array, "a share of light samples is not from 0.3 to 1"),
    ("selection.probability", lambda array: array + 1.0, "a guiding probability is not from 0"),
    ("mixture.lobe_count", lambda array: array + MAX_LOBES, "a region has too many lobes"),
    ("mixture.bounds", lambda array: array[::-1], "bounds are not ordered"),
    ("mixture.region_leaf", lambda array: array[::-1], "regions have other leaves than the tree"),
])  # fmt: skip
def test_arrays_that_do_not_hang_together_are_refused(name: str, change: Any, message: str) -> None:
    state = learned_models(0)[0].state()
    RegionModels.of_state(state, 0.5)
    with pytest.raises(StateError, match=message):
        RegionModels.of_state(state | {name: np.ascontiguousarray(change(state[name]))}, 0.5)
    with pytest.raises(StateError, match=f"{name.partition('.')[2]} is missing"):
        RegionModels.of_state({key: array for key, array in state.items() if key != name}, 0.5)


def test_the_digest_tells_fields_apart() -> None:
    one = learned_field(0)
    assert one.digest == learned_field(0).digest
    assert len({one.digest, learned_field(1).digest, replace(one, samples=13.0).digest}) == 3
    lobes = one.state["mixture.lobes"].copy()
    lobes[0, 0, 0] = np.nextafter(lobes[0, 0, 0], np.float32(2.0))
    assert replace(one, state=one.state | {"mixture.lobes": lobes}).digest != one.digest
    assert len({one.seed(0), one.seed(1), learned_field(1).seed(0), 0, 1}) == 5


# ---------------------------------------------------------------------------------------------------------------------
# Renders


def test_a_render_starts_from_what_another_has_learned_and_goes_on_learning(session: Session) -> None:
    assert session.render().learned is None
    first = session.render(keep=True)
    assert first.learned is not None and first.learned.samples == 15.0
    assert not first.report.guiding.started_from
    second = session.render(start=first.learned, keep=True)
    assert second.report.notices == []
    assert second.report.guiding.started_from == str(first.learned)
    assert any("started from what earlier renders had learned: 15 samples" in line
               for line in second.report.guiding.lines)
    assert second.learned is not None and second.learned.samples == 30.0
    assert second.learned.region_count > first.learned.region_count
    # What the first has learned is as it was.
    third = session.render(start=first.learned, keep=True)
    np.testing.assert_array_equal(image(third), image(second))
    assert third.learned is not None and third.learned.digest == second.learned.digest


def test_the_first_sample_is_guided(session: Session) -> None:
    learned = session.render(keep=True).learned
    session.settings = replace(session.settings, samples=1)
    assert np.isnan(session.render().report.guiding.guided_share)
    assert session.render(start=learned).report.guiding.guided_share > 0.0


def test_samples_of_a_render_that_knows_enough_count_alike() -> None:
    settings = RenderSettings(guiding_method="VMM")
    assert [iteration_weight(first, settings, 8.0) for first in (0, 1, 3, 7)] == [1.0] * 4
    assert iteration_weight(1, settings, 2.0) == iteration_weight(3, settings)


def test_the_image_does_not_depend_on_threads(session: Session) -> None:
    learned = session.render(keep=True).learned
    one = session.render(start=learned, keep=True)
    session.settings = replace(session.settings, threads=2)
    two = session.render(start=learned, keep=True)
    np.testing.assert_array_equal(image(one), image(two))
    assert one.learned is not None and two.learned is not None and one.learned.digest == two.learned.digest


def test_another_view_and_size_starts_from_it_and_reaches_farther(session: Session) -> None:
    """The field grows to what the first view has not seen."""
    learned = session.render(keep=True).learned
    assert learned is not None
    description = pit_scene()
    turned = looking_down().transform.copy()
    turned[:3, 3] = (40.0, 0.0, 10.0)
    frame = replace(description.frame, width=20, height=30, region=(0, 0, 20, 30))
    session.load(replace(description, camera=Camera(transform=turned), frame=frame))
    result = session.render(start=learned, keep=True)
    assert result.report.notices == [] and result.learned is not None
    old, new = (item.state["mixture.bounds"] for item in (learned, result.learned))
    assert old[1, 0] < 30.0 < new[1, 0]
    assert (new[0] <= old[0]).all() and (new[1] >= old[1]).all()


def brighter(description: SceneDescription) -> SceneDescription:
    lamp = description.lights[0]
    return replace(description, lights=[replace(lamp, energy=2.0 * lamp.energy)])


def moved(description: SceneDescription) -> SceneDescription:
    transform = description.instances.transform.copy()
    transform[0, 2, 3] += 0.1
    return replace(description, instances=replace(description.instances, transform=transform))


def recoloured(description: SceneDescription) -> SceneDescription:
    return replace(description, materials=[material(color=(0.1, 0.1, 0.1))])


@pytest.mark.parametrize("change", [brighter, moved, recoloured])
def test_a_field_of_another_scene_is_dropped_with_a_notice(change: Any, session: Session) -> None:
    learned = session.render(keep=True).learned
    session.load(change(pit_scene()))
    plain, dropped = session.render(), session.render(start=learned)
    np.testing.assert_array_equal(image(plain), image(dropped))
    assert not dropped.report.guiding.started_from
    (notice,) = dropped.report.notices
    assert notice.subject == "Learned field" and notice.fallback == "the render learns anew"
    assert "are not those that it was learned with" in notice.problem


def test_what_no_render_could_start_from_is_not_kept(session: Session) -> None:
    """Squares of light so bright are beyond what a state may hold: the next render was lost by it."""
    scene = pit_scene()
    session.settings = replace(session.settings, guiding_method="TABLE_RIS")
    session.load(replace(scene, lights=[replace(lamp, energy=1e16 * lamp.energy) for lamp in scene.lights]))
    result = session.render(keep=True)
    assert np.isfinite(image(result)).all() and image(result).max() > 1e14
    assert result.learned is None
    (notice,) = result.report.notices
    assert "holds numbers that are too large" in notice.problem and notice.fallback == "the next render learns anew"


def test_an_unguided_render_starts_from_nothing(session: Session) -> None:
    learned = session.render(keep=True).learned
    session.settings = replace(session.settings, guiding_method="OFF")
    plain, started = session.render(), session.render(start=learned, keep=True)
    np.testing.assert_array_equal(image(plain), image(started))
    assert started.learned is None


def test_a_cancelled_render_keeps_what_it_has_learned(session: Session) -> None:
    session.settings = replace(session.settings, samples=100_000)
    result = session.render(keep=True, should_cancel=iter([*[False] * 30, *[True] * 1000]).__next__)
    assert result.report.cancelled and result.learned is not None and result.learned.samples > 0.0


@pytest.mark.parametrize(
    "method", ["TABLE_RIS", "VMM_RIS", pytest.param("SDTREE", marks=pytest.mark.slow), "AUTO"]
)
def test_every_method_starts_from_what_the_others_know(method: str, session: Session) -> None:
    """A table comes back; where there is none, or a tree must be learned anew, mixtures are a start all the same."""
    by_mixtures = session.render(keep=True).learned
    session.settings = replace(
        session.settings, guiding_method=method, candidate_allocation="FIXED", candidate_count=2, samples=16
    )
    first = session.render(start=by_mixtures, keep=True)
    assert first.learned is not None and ("table.sums" in first.learned.state) == (method == "TABLE_RIS")
    second = session.render(start=first.learned, keep=True)
    assert second.learned is not None
    if method == "TABLE_RIS":
        counts = [int(part(item.state, "table")["update_count"][0]) for item in (first.learned, second.learned)]
        assert 0 < counts[0] < counts[1]
    assert np.isfinite(image(second)).all()


def test_a_table_that_is_begun_on_saved_mixtures_has_all_their_regions() -> None:
    """It had one: kernels read far behind it, and once that ended the process."""
    regions, _ = learned_models(0)
    known = replace(learned_field(0), state=regions.state())
    settings = RenderSettings(candidate_allocation="FIXED", **{**GUIDED, "guiding_method": "TABLE_RIS"})
    learner = make_learner(settings, 1, 100, request=LearningRequest(start=known))
    assert learner is not None
    guidance = learner.first()
    learner.close()
    assert guidance.table is not None
    assert len(guidance.table.values) == known.region_count > 1
    guidance.check_regions()


def test_what_is_not_of_the_fields_regions_reaches_no_kernel() -> None:
    regions, table = learned_models(0)
    count = regions.mixture.region_count
    settings = RenderSettings(**GUIDED)
    guidance = Guidance(settings, 0, table=table.field).with_regions(
        regions.field, regions.probability(is_learned=True), regions.light_share.share, regions.selection.benefit,
        Allocation(regions.variance_deltas(), np.zeros(2, np.float32)), None, guides_media=True,
    )
    guidance.check_regions()
    scene = build_scene(pit_scene(), settings, SceneCache())
    tracer = Tracer(scene, settings)
    tracer.follow(guidance)
    two = np.zeros(2, np.float32)
    for field, name, wrong in (
        ("table", "table", TableModel().field),
        ("probability", "guiding probability", two),
        ("light_share", "light share", two),
        ("benefit", "benefit of guiding", two),
        ("allocation", "candidate allocation", Allocation(two, two)),
    ):
        with pytest.raises(ValueError, match=f"the {name} knows [12] regions, and the mixture field has {count}"):
            tracer.follow(replace(guidance, **{field: wrong}))


@pytest.mark.parametrize(("verdict", "compared"), [(WON, 0), (LOST, 3), (OPEN, 3)])
def test_what_won_is_compared_later_and_what_lost_is_learned_anew(
    verdict: str, compared: int, session: Session
) -> None:
    """But from other random numbers, since that it lost depends on those that it had."""
    learned = session.render(keep=True).learned
    assert learned is not None
    session.settings = replace(session.settings, guiding_trial=True, samples=31)
    report = session.render(start=replace(learned, verdict=verdict, efficiency=1.5)).report.guiding
    assert (len(report.trials) > 0) == (compared > 0)
    assert len(report.trials) <= compared
    assert bool(report.lost_before) == (verdict == LOST) == (not report.started_from)
    session.settings = replace(session.settings, samples=1)
    result = session.render(start=replace(learned, verdict=verdict))
    assert np.isnan(result.report.guiding.guided_share) == (verdict == LOST)
    assert np.any(image(result) != image(session.render()))
    # Who wants no trial gets what was learned.
    session.settings = replace(session.settings, guiding_trial=False)
    assert session.render(start=replace(learned, verdict=verdict)).report.guiding.guided_share > 0.0


# ---------------------------------------------------------------------------------------------------------------------
# The mean


def means(seeds: int, learned_samples: int, **settings: Any) -> tuple[np.ndarray, np.ndarray]:
    """Image means by seed: of renders that start from what a render with the same seed has learned, and of unguided
    ones."""
    started, plain = [], []
    made = Session(RenderSettings(**GUIDED))
    made.load(corner_scene())
    for seed in range(seeds):
        ours = RenderSettings(**{**GUIDED, "samples": 15, "seed": seed, **settings})
        made.settings = replace(ours, samples=learned_samples)
        learned = made.render(keep=True).learned
        made.settings = ours
        started.append(image(made.render(start=learned)).mean())
        made.settings = replace(ours, guiding_method="OFF")
        plain.append(image(made.render()).mean())
    made.close()
    return np.array(started), np.array(plain)


@pytest.mark.parametrize("method", ["VMM", "TABLE_RIS"])
def test_a_render_from_its_own_field_has_the_right_mean(method: str) -> None:
    """Z-test at four standard errors, fixed seeds."""
    started, plain = means(8, 15, guiding_method=method)
    assert z_score(started, plain) < Z_LIMIT
    # The test can see a bias of 5%.
    assert z_score(started * 1.05, plain) > Z_LIMIT


def lamp_scene() -> SceneDescription:
    """A few square centimetres of a floor under a large lamp, far away: light from the same directions everywhere."""
    glow = material("Glow", (4.0, 4.0, 4.0), "ShaderNodeEmission")
    lamp = np.array([[0.3, 0, 0, 30], [0, 0.3, 0, 0], [0, 0, 0.3, 60], [0, 0, 0, 1]], np.float32)
    description = floor_scene(
        materials=[material(), glow], transforms=[np.eye(4, dtype=np.float32), lamp], size=(4800, 4800)
    )
    instances = description.instances
    instances.material_offset, instances.materials = np.array([0, 1], np.int32), np.array([0, 1], np.int32)
    return replace(description, frame=replace(description.frame, region=(2400, 2400, 2408, 2408)))


def planted(seed: int) -> LearnedField:
    """Sharp lobes towards the light that the 64 paths of a seed's first sample have found, and nowhere else."""
    made = lamp_session(seed)
    sink = RowSink((0.0, 1.0))
    learned = made.render(start=neutral(), keep=True, sink=sink).learned
    made.close()
    assert learned is not None
    rows = np.concatenate(sink.rows)
    rows = rows[(rows[:, ROW_RADIANCE] > 0.0) & (rows[:, ROW_PDF] > 0.0)]
    found = rows[:MAX_LOBES, ROW_WI : ROW_WI + 3]
    assert len(found) >= 4
    kappa = 2000.0
    state = dict(learned.state)
    lobes = np.zeros_like(state["mixture.lobes"])
    lobes[:, LOBE_WEIGHT, : len(found)] = 1.0 / len(found)
    lobes[:, LOBE_KAPPA, : len(found)] = kappa
    lobes[:, LOBE_X : LOBE_Z + 1, : len(found)] = found.T
    lobes[:, LOBE_INVERSE_DISTANCE] = 0.0
    lobes[:, LOBE_COEFFICIENT, : len(found)] = kappa / (2.0 * np.pi) / len(found)
    state["mixture.lobes"] = lobes
    state["mixture.lobe_count"] = np.full_like(state["mixture.lobe_count"], len(found))
    state["mixture.is_ready"] = np.ones_like(state["mixture.is_ready"])
    return replace(learned, state=state)


def lamp_session(seed: int) -> Session:
    made = Session(RenderSettings(
        guiding_method="VMM", samples=1, seed=seed, max_bounces=1, threads=1, guiding_trial=False, use_nee=False,
        use_russian_roulette=False, learn_guiding_probability=False, filter_glossy=0.0,
    ))  # fmt: skip
    made.load(lamp_scene())
    return made


@cache
def neutral() -> LearnedField:
    """A field that sends half of the paths where those of `planted` are sent, so that the other half is the same."""
    made = lamp_session(10_000)
    made.settings = replace(made.settings, samples=15)
    learned = made.render(keep=True).learned
    made.close()
    assert learned is not None
    return learned


def planted_means(seeds: int) -> np.ndarray:
    found = []
    for seed in range(seeds):
        made = lamp_session(seed)
        found.append(image(made.render(start=planted(seed))).mean())
        made.close()
    return np.array(found)


def test_a_field_is_independent_of_the_samples_that_it_guides(monkeypatch: pytest.MonkeyPatch) -> None:
    """The field knows where the very paths of the same seed would go, if these were drawn once more.

    They would be found too likely, and count for less than they should. With the field's digest in the random numbers
    they are others. Z-tests at four standard errors, fixed seeds.
    """
    seeds = 60
    made = lamp_session(0)
    made.settings = replace(made.settings, guiding_method="OFF", samples=256, seed=5)
    truth = np.array([image(made.render())[row].mean() for row in range(8)])
    made.close()
    assert truth.mean() > 0.01
    assert z_score(planted_means(seeds), truth) < Z_LIMIT
    monkeypatch.setattr(LearnedField, "seed", lambda _learned, seed: seed)
    assert z_score(planted_means(seeds), truth) > Z_LIMIT
