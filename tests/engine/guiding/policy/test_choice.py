# SPDX-License-Identifier: GPL-3.0-or-later
"""What is chosen, given what comparisons find; and whole renders with AUTO: unbiased, and close to the best method."""

import itertools

import numpy as np
import pytest

from engine.guiding.policy import trial
from engine.guiding.policy.plain_trial import PlainTrial
from engine.guiding.policy.questions.method import MethodTrial
from engine.guiding.policy.rules import Rules
from engine.guiding.policy.trial import ArmSamples
from engine.state.film import FilmTile, allocate_tile
from engine.state.unit import CHALLENGER, CURRENT, PLAIN, Unit
from tests.helpers.seeded_renders import Z_LIMIT, render, z_score
from tests.helpers.small_scenes import corner_scene, pit_scene

#: Of an iteration: so many that variances tell efficiencies to a thousandth.
SAMPLES = 1 << 14
WEIGHTS = np.ones(1, np.float32)


class Choice:
    """Guiding compared with unguided rendering, and methods with each other, as their questions do it."""

    def __init__(self, pixel_count: int, rung: str, *, tries_plain: bool) -> None:
        self.plain = PlainTrial(pixel_count, tries_plain=tries_plain)
        self.method = MethodTrial(pixel_count, rung)
        self.arms = [ArmSamples(0, 1, CURRENT)]
        self.trials: list[str] = []
        self.is_narrow = False

    rung = property(lambda self: self.method.rung)
    challenger = property(lambda self: self.method.challenger)
    has_lost = property(lambda self: self.plain.has_lost)
    efficiency = property(lambda self: self.plain.efficiency)
    is_paying = property(lambda self: self.plain.is_paying)

    def compare(self, unit, film, cost):
        self.plain.compare(unit, film, cost, is_aside=False)
        self.method.compare(unit, film, cost)

    def judge(self, weights, next_sample, overhead, samples_left=np.inf, **how):
        says = self.plain.judge(weights, next_sample, overhead, samples_left, **how)
        said = self.method.judge(weights, next_sample, overhead)
        self.trials += [f"OFF {self.plain.efficiency}"] * says + [said] * bool(said)

    def plan(self, first, count, offers, *, is_last=False, **how):
        is_free, is_last = not self.challenger, is_last or self.is_narrow
        arms = self.plain.plan(first, count, is_free=is_free, is_last=is_last, **how)
        if is_last:
            self.method.drop()
        elif not arms and self.plain.is_settled:
            arms = self.method.plan(first, count, offers)
        self.arms = arms or [ArmSamples(first, count, CURRENT)]


def unit_of(arm_samples: ArmSamples, variance: float) -> tuple[Unit, FilmTile]:
    """A unit of one pixel whose samples have mean zero and this variance."""
    unit = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int64), *arm_samples)
    tile = allocate_tile(1, 3)
    tile.square[:] = variance * arm_samples.sample_count
    return unit, tile


def render_parts(choice, worth):
    """Render the planned iteration by methods whose variance is one over what `worth` says, at the same cost."""
    methods = {PLAIN: "OFF", CURRENT: choice.rung, CHALLENGER: choice.challenger}
    for arm_samples in choice.arms:
        choice.compare(*unit_of(arm_samples, 1.0 / worth[methods[arm_samples.arm]]), arm_samples.sample_count)


def is_comparing(choice):
    return len(choice.arms) > 1


def run(worth, *, iterations=40, offers=("VMM_RIS", "TABLE_RIS", "VMM"), tries_plain=True):
    """A choice after so many iterations in which methods are worth what `worth` says, OFF being 1."""
    choice = Choice(1, "VMM", tries_plain=tries_plain)
    first, history = 1, []
    for _ in range(iterations):
        if is_comparing(choice):
            render_parts(choice, worth)
        choice.judge(WEIGHTS, first, 0.0)
        if choice.has_lost:
            return choice, history, first
        choice.plan(first, SAMPLES, offers)
        history.append((choice.rung, choice.challenger, [arm_samples.arm for arm_samples in choice.arms]))
        assert [s for f, n, _ in choice.arms for s in range(f, f + n)] == list(range(first, first + SAMPLES))
        first += SAMPLES
    return choice, history, first


def test_what_is_in_use_goes_on_once_few_pixels_are_left():
    """Whatever was being compared then: what so few tell is luck."""
    choice, _, first = run({"OFF": 1.0, "VMM": 4.0, "VMM_RIS": 4.0, "TABLE_RIS": 4.0}, iterations=8)
    while not is_comparing(choice):
        choice.judge(WEIGHTS, first, 0.0)
        choice.plan(first, SAMPLES, ("VMM_RIS", "VMM"))
        first += SAMPLES
    choice.is_narrow = True
    for _ in range(40):
        choice.judge(WEIGHTS, first, 0.0)
        choice.plan(first, SAMPLES, ("VMM_RIS", "VMM"))
        assert choice.arms == [ArmSamples(first, SAMPLES, CURRENT)]
        assert (choice.rung, choice.challenger, choice.has_lost) == ("VMM", "", False)
        first += SAMPLES


def test_unguided_rendering_is_compared_first():
    choice, history, _ = run({"OFF": 1.0, "VMM": 4.0, "VMM_RIS": 4.0, "TABLE_RIS": 4.0})
    firsts = [arms for _, _, arms in history if len(arms) > 1]
    assert firsts[0] == [CURRENT, PLAIN] and all(arms == [CURRENT, CHALLENGER] for arms in firsts[1:])
    assert choice.efficiency == pytest.approx(4.0, rel=1e-3)


def test_guiding_that_loses_is_given_up_soon():
    _, _, first = run({"OFF": 1.0, "VMM": 0.4})
    assert first <= 1 + 4 * SAMPLES


@pytest.mark.filterwarnings("ignore:overflow encountered")
@pytest.mark.parametrize("worth", [np.inf, 1e-60])
def test_a_black_picture_and_one_without_bounds_have_lost(worth):
    """Nothing varies in the first, and in the second a variance is no number of float32."""
    choice, _, first = run({"OFF": 1.0, "VMM": worth})
    assert choice.has_lost and not choice.is_paying and first <= 1 + 4 * SAMPLES
    choice, history, _ = run({"OFF": 1.0, "VMM": 4.0, "VMM_RIS": worth}, offers=("VMM_RIS", "VMM"))
    assert choice.rung == "VMM" and not choice.has_lost
    assert 0 < sum(challenger == "VMM_RIS" for _, challenger, _ in history) < 5


def test_one_lucky_comparison_does_not_bind_for_good():
    """Guiding that looked twice as good once, and is worth less than nothing, is left at four times the samples."""
    for later, is_kept in ((0.9, False), (1.1, True)):
        choice, first, count = Choice(1, "VMM", tries_plain=True), 1, 0
        for _ in range(120):
            if is_comparing(choice):
                render_parts(choice, {"OFF": 1.0, "VMM": 2.1 if count == 0 else later})
                count += 1
            choice.judge(WEIGHTS, first, 0.0)
            if choice.has_lost:
                break
            choice.plan(first, SAMPLES, ())
            first += SAMPLES
        assert choice.has_lost != is_kept
        # One at first, and then three at a time.
        assert count in ((1 + 3 * 2, 1 + 3 * 3) if is_kept else (1 + 3,)), count


def test_the_first_comparison_is_not_believed_so_easily():
    choice, first, worth = Choice(1, "VMM", tries_plain=True), 1, iter((1.5, 1.1, 1.0, 0.95))
    while not choice.has_lost:
        if is_comparing(choice):
            render_parts(choice, {"OFF": 1.0, "VMM": next(worth)})
        choice.judge(WEIGHTS, first, 0.0)
        choice.plan(first, SAMPLES, ())
        first += SAMPLES
    assert len(choice.trials) == 4


@pytest.mark.parametrize("is_part", [True, False])
def test_what_has_paid_once_gets_the_benefit_of_the_doubt_unless_a_part_of_the_pixels_said_so(is_part):
    choice, first, worth = Choice(1, "VMM", tries_plain=True), 8, iter((1.4, 1.1))
    # So that nothing is compared before its time.
    for _ in range(2):
        choice.judge(WEIGHTS, 1, 0.0)
    for part in (is_part, False):
        choice.plan(first, SAMPLES, ())
        render_parts(choice, {"OFF": 1.0, "VMM": next(worth)})
        first += SAMPLES
        choice.judge(WEIGHTS, first, 0.0, samples_left=first, is_part=part)
    assert len(choice.trials) == 2 and choice.has_lost == is_part


def test_what_is_clearly_better_is_not_doubted():
    _, history, _ = run({"OFF": 1.0, "VMM": 4.0}, offers=())
    assert sum(len(arms) > 1 for _, _, arms in history) == 1


@pytest.mark.parametrize("best", ["VMM", "VMM_RIS", "TABLE_RIS"])
def test_the_best_method_is_found(best):
    worth = {"OFF": 1.0, "VMM": 2.0, "VMM_RIS": 2.0, "TABLE_RIS": 2.0} | {best: 2.6}
    choice, history, _ = run(worth)
    assert choice.rung == best
    assert {challenger for _, challenger, _ in history} >= {"VMM_RIS", "TABLE_RIS"}, "all were tried"
    compared = sum(len(arms) > 1 for _, _, arms in history)
    assert compared < 0.5 * len(history)


def test_a_method_that_lost_is_tried_again_much_later():
    _, history, _ = run({"OFF": 1.0, "VMM": 2.0, "VMM_RIS": 1.0}, offers=("VMM_RIS", "VMM"), iterations=80)
    tried = [k for k, (_, challenger, _) in enumerate(history) if challenger == "VMM_RIS"]
    assert len(tried) > 1 and all(b >= 3 * a for a, b in itertools.pairwise(tried))


def test_a_finer_method_that_no_longer_pays_is_left():
    worth = {"OFF": 1.0, "VMM": 2.0, "VMM_RIS": 4.0}

    class Fading(dict):
        """Resampling pays at the beginning only."""

        asked = 0

        def __getitem__(self, method):
            self.asked += method == "VMM_RIS"
            return 1.0 if method == "VMM_RIS" and self.asked > 1 else super().__getitem__(method)

    choice, history, _ = run(Fading(worth), offers=("VMM_RIS", "VMM"), iterations=80)
    assert any(rung == "VMM_RIS" for rung, _, _ in history)
    assert choice.rung == "VMM"


def test_nothing_is_compared_without_offers():
    _, history, _ = run({"OFF": 1.0, "VMM": 2.0}, offers=(), tries_plain=False)
    assert all(arms == [CURRENT] for _, _, arms in history)


def test_nothing_is_compared_that_nobody_will_go_by():
    choice, _, first = run({"OFF": 1.0, "VMM": 0.9}, iterations=4)
    assert is_comparing(choice)
    choice.judge(WEIGHTS, first, 0.0)
    choice.plan(first, SAMPLES, ("VMM_RIS", "VMM"), is_last=True)
    assert choice.arms == [ArmSamples(first, SAMPLES, CURRENT)] and not choice.has_lost


def test_a_challenger_that_is_no_longer_offered_is_dropped():
    choice = Choice(1, "VMM", tries_plain=False)
    choice.judge(WEIGHTS, 1, 0.0)
    choice.plan(1, SAMPLES, ("VMM_RIS", "VMM"))
    assert choice.challenger == "VMM_RIS"
    choice.plan(1 + SAMPLES, SAMPLES, ())
    assert not choice.challenger and len(choice.arms) == 1


@pytest.mark.parametrize("is_whole", [True, False])
def test_within_a_stratum_guiding_is_compared_with_its_own_unguided_samples(is_whole: bool) -> None:
    """Unguided samples of all strata vary more than those of one: guiding would seem to be what they gain."""
    choice, first = Choice(1, "VMM", tries_plain=True), 0
    count = 16
    for _ in range(3):
        choice.plan(first, count, (), knows_something=False)
        for arm_samples in choice.arms:
            choice.compare(*unit_of(arm_samples, 100.0), 1.0)
        first += count
        choice.judge(WEIGHTS, first, 0.0)
    choice.plan(first, count, (), is_whole=is_whole)
    assert [arm_samples.arm for arm_samples in choice.arms] == [CURRENT, PLAIN]
    for arm_samples in choice.arms:
        choice.compare(*unit_of(arm_samples, 1.0), 1.0 * arm_samples.sample_count)
    choice.judge(WEIGHTS, first + count, 0.0)
    # A variance of four samples is four thirds of their mean square, that of twelve twelve elevenths.
    expected = (4.0 / 3.0) / (12.0 / 11.0)
    assert choice.efficiency > 50.0 if is_whole else choice.efficiency == pytest.approx(expected, rel=1e-6)


# Whole renders

SETTINGS = {"samples": 127, "max_bounces": 12, "diffuse_bounces": 12}


@pytest.mark.parametrize("scene", [pit_scene, corner_scene])
def test_the_mean_is_that_of_an_unguided_render(scene):
    """All methods take part: resampling is taken to promise much, and every method to win."""
    rules = Rules(
        least_resampled=-1.0, table_updates=1, taken=(0.0, 0.0, 0.0), least_efficiency={3: 0.0, 4: 0.0},
        least_of_short=0.0,
    )
    means, chosen = [], set()
    for seed in range(6):
        result = render("AUTO", seed, scene=scene, deterministic=True, rules=rules, **SETTINGS)
        means.append(result.passes["Combined"][..., :3].mean())
        chosen.add(result.report.guiding.chosen)
    assert chosen == {"TABLE_RIS"}
    plain = [render("OFF", s, scene=scene, **SETTINGS).passes["Combined"][..., :3].mean() for s in range(6)]
    means, plain = np.array(means), np.array(plain)
    assert z_score(means, plain) < Z_LIMIT
    assert z_score(1.02 * means, plain) > Z_LIMIT, "a bias of 2% would be seen"


def test_the_image_does_not_depend_on_threads():
    images = [
        render("AUTO", 1, scene=pit_scene, deterministic=True, threads=threads, **SETTINGS).passes["Combined"]
        for threads in (1, 2)
    ]
    assert np.array_equal(*images)


def test_the_report_says_what_was_chosen():
    report = render("AUTO", 1, scene=pit_scene, deterministic=True, **SETTINGS).report.guiding
    assert report.chosen in ("OFF", "VMM", "VMM_RIS", "TABLE_RIS")
    assert any(line.startswith("chose ") for line in report.lines)
    assert any(line.startswith("compared: VMM over OFF") for line in report.lines)


def test_renders_of_a_few_samples_are_left_alone():
    automatic = render("AUTO", 1, scene=pit_scene, samples=8)
    assert np.array_equal(automatic.passes["Combined"], render("OFF", 1, scene=pit_scene, samples=8).passes["Combined"])
    assert automatic.guidance is None
    assert automatic.report.guiding.chosen == "OFF" and "few samples" in automatic.report.guiding.lines[0]


def test_what_a_noise_threshold_leaves_counts_as_left(monkeypatch):
    """A render that is far from its threshold is as long as one without: guiding has as much benefit of the doubt."""
    left, least_efficiency = {}, trial.least_efficiency

    def note(iteration, next_sample, samples_left, **options):
        left[next_sample] = samples_left
        return least_efficiency(iteration, next_sample, samples_left, **options)

    monkeypatch.setattr(trial, "least_efficiency", note)
    threshold = {"use_adaptive_sampling": True, "adaptive_threshold": 1e-4}
    render("AUTO", 1, scene=pit_scene, deterministic=True, **SETTINGS, **threshold)
    assert left and left == {sample: SETTINGS["samples"] - sample for sample in left}
