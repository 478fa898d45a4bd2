# SPDX-License-Identifier: GPL-3.0-or-later
"""Every method on every way in which guiding is known to fail: no bias, nothing that is not a number.

Methods guide wherever they can, whether it pays or not. A test's chance to fail for an unbiased method is
`bias.SIGNIFICANCE` for each method (normal noise; seeds are fixed). It says, too, whether it would see a bias of 2% of
the image: what it can detect with a probability of 95% is below, and the same pictures with 2% more or less light are
found biased. The suite's command says more: `python -m benchmarks stability`.

Noise of networks that know nothing is not normal: where few bright samples came, a cell is darker and its noise looks
smaller than it is, and one in ten such cells of `roughness-0.1` was beyond the limit. So what is found is looked for
again in new and longer renders, by the same limits: a bias is in them too.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import metrics
from benchmarks.__main__ import main
from benchmarks.bias import MEAN_LIMIT, SIGNIFICANCE, BiasTest, detects, find_bias, variance_ratio
from benchmarks.images import Float32Array
from benchmarks.stability import evaluate, measure_case, method_settings, render_case
from benchmarks.stability_cases import CASES, Case, describe_case, find_cases
from benchmarks.stability_figures import LEAST_BIAS, Picture
from engine.guiding.policy import sets
from engine.methods import METHODS, SOURCES
from engine.settings import RenderSettings
from tests.helpers.kept_arrays import KeptArrays
from tests.helpers.some_cases import every, has_all, some_of
from tests.helpers.training import require_torch
from tests.helpers.untrained_networks import BadNetwork, Untrained, ask

#: Pictures by case.
References = Callable[[Case], list[Float32Array]]

NETWORKS = (*(source.name for source in SOURCES.values() if source.is_network), "NEURAL_RIS")
STATISTICAL = [method for method in METHODS if method not in ("OFF", *NETWORKS)]
#: Quick and different: near field, colours, a scale that float32 can just square, no extent along an axis, one sample.
FAST = ("parallax", "colors", "scale-1e6", "coplanar", "few-1")
#: Where regions learn which lights they see.
WITH_HIDDEN_LIGHTS = ("ten-rooms", "street")

#: Where methods are left to choose how much to guide: forced, the weights of long paths spread so far that a few
#: hundred samples show neither mean nor noise (docs/decisions/stability.md).
UNFORCED = ("albedo", "albedo-100", "fog-albedo")
#: Not tested, by case: of 1,420 forced renders by SDTREE_VARIANCE one had 34 times the mean, and most are too dark, so
#: the noise of a few says nothing (docs/decisions/stability.md). Trees are tested at sixteen bounces, where 200 seeds
#: do.
UNTESTED = {"albedo-100": ("SDTREE", "SDTREE_VARIANCE", *NETWORKS)}
#: Not tested here, since they take up to minutes each: `python -m benchmarks stability 'fog-*'` has all of them.
LONG = tuple(f"fog-{what}" for what in "door dense albedo lamp glass boundary speck shreds nested".split())
IN_TIME = [name for name in CASES if name not in LONG]
LONG_FOR_NETWORKS = ("long",)
#: Media that go beyond what rounding, weights or lists of media have room for.
BAD_MEDIA = tuple(
    f"fog-{what}" for what in "albedo thin dense forward backward nested huge boundary coplanar speck shreds".split()
)


def by_turns(methods: Sequence[str], count: int, cases: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """So many of the methods for each case, by turns, so that each meets its share; the command has them all."""
    total = len(methods)
    many = total if has_all() else count
    return {name: tuple(methods[(many * k + n) % total] for n in range(many)) for k, name in enumerate(cases)}


SOME_NETWORKS = by_turns(NETWORKS, 1, IN_TIME)
SOME_STATISTICAL = by_turns(STATISTICAL, 2, IN_TIME)
HALF_OF_STATISTICAL = by_turns(STATISTICAL, 3, FAST)

#: Most pictures are of nine blocks of pixels (`benchmarks.block_noise`). Of two seeds, blocks so few say little of the
#: noise: to find the same bias by Student's t takes three times as many samples as by six seeds.
SEEDS = 6
#: The reference's seeds, and its samples over those of the case.
REFERENCE_SEEDS, REFERENCE_FACTOR = range(1001, 1009), 2
#: A guide that is forced upon a scene has so many times the variance of unguided rendering, mostly.
VARIANCE_ALLOWANCE = 2.0
SAMPLES, LONG_SAMPLES, MOST_SAMPLES = (15, 31, 63, 127, 255), 511, 8191
#: Where a bias was found: seeds to look for it again.
CONFIRMING_SEEDS = range(11, 23)


def pictures(case: Case, method: str, samples: int, seeds: Sequence[int]) -> list[Picture]:
    description, base = describe_case(case, threads=1)
    base = replace(base, samples=samples)
    settings = method_settings(method, base, forced=case.name not in UNFORCED)
    return [render_case(description, replace(settings, seed=seed), case.earlier_sizes) for seed in seeds]


def reference_images(case: Case) -> list[Float32Array]:
    plain = replace(case, earlier_sizes=())
    return [p.image for p in pictures(plain, "OFF", REFERENCE_FACTOR * case.samples, REFERENCE_SEEDS)]


@pytest.fixture(scope="session")
def references(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> References:
    """References of this run of the tests: of a case they are rendered once, by whichever worker needs them first."""
    folder = tmp_path_factory.getbasetemp()
    kept = KeptArrays(folder if worker_id == "master" else folder.parent)

    def of_case(case: Case) -> list[Float32Array]:
        return list(kept.get(f"stability-{case.name}", lambda: np.stack(reference_images(case))))

    return of_case


def enough_samples(case: Case, references: Sequence[Float32Array]) -> int:
    """Samples with which a bias of 2% will be seen, by the noise of the reference alone."""
    if case.name.startswith("few"):
        return case.samples
    if case.name == "long":
        # 35 iterations: what takes more is left to the suite's command.
        return LONG_SAMPLES
    of_references = find_bias(references, references)
    error = of_references.error / math.sqrt(2.0)
    errors_to_detect = of_references.detectable / max(of_references.error, 1e-12)
    of_sample = error**2 * len(references) * REFERENCE_FACTOR * case.samples
    for samples in SAMPLES:
        expected = math.sqrt(VARIANCE_ALLOWANCE * of_sample / (SEEDS * samples) + error**2)
        if errors_to_detect * expected < 0.9 * LEAST_BIAS:
            return samples
    return SAMPLES[-1]


def measured(
    case: Case, method: str, samples: int, references: Sequence[Float32Array]
) -> tuple[list[Picture], BiasTest]:
    rendered = pictures(case, method, samples, range(1, SEEDS + 1))
    return rendered, find_bias([picture.image for picture in rendered], references)


def problems(case: Case, methods: Sequence[str], references: Sequence[Float32Array]) -> list[str]:
    """What is wrong with the methods' pictures of a case, or with the test itself."""
    samples = enough_samples(case, references)
    found = []
    for method in methods:
        if method in UNTESTED.get(case.name, ()):
            continue
        taken = samples
        rendered, bias = measured(case, method, taken, references)
        while bias.detectable > 0.9 * LEAST_BIAS and taken < MOST_SAMPLES:
            # As many samples as the noise asks for, whatever was found; and all of them new.
            taken = min(math.ceil(taken * (bias.detectable / (0.75 * LEAST_BIAS)) ** 2), MOST_SAMPLES)
            rendered, bias = measured(case, method, taken, references)
        images = [picture.image for picture in rendered]
        print(f"{case.name} {method}, {taken} samples: {bias}")
        if bias.is_biased and all(np.isfinite(image).all() for image in images):
            again = pictures(case, method, taken, CONFIRMING_SEEDS)
            bias = find_bias([picture.image for picture in again], references)
            print(f"  again: {bias}")
        checks = {
            "is biased": not bias.is_biased,
            "is too noisy to tell": bias.detectable <= LEAST_BIAS,
            "hides 2% planted": detects(images, references, LEAST_BIAS) and detects(images, references, -LEAST_BIAS),
            "is not finite": all(np.isfinite(image).all() for image in images),
            f"had to give up: {rendered[0].notices}": not any("Guiding" in n for p in rendered for n in p.notices),
        }
        found += [f"{method} {name}, {taken} samples: {bias}" for name, is_right in checks.items() if not is_right]
    return found


def draw_networks_at_random(monkeypatch: pytest.MonkeyPatch) -> None:
    """Have networks parameters drawn at random: no worker to wait for, and worse than any that was trained."""
    make = sets.make_source_model
    monkeypatch.setattr(
        sets, "make_source_model",
        lambda settings: Untrained(settings, 4.0) if SOURCES[settings.source].is_network else make(settings),
    )  # fmt: skip
    ask(BadNetwork("random"), monkeypatch)


@pytest.mark.parametrize("name", FAST)
def test_statistical_methods_are_unbiased_where_guiding_is_hard(name: str, references: References) -> None:
    assert not problems(CASES[name], HALF_OF_STATISTICAL[name], references(CASES[name]))


def wrong_in_media(name: str, methods: Sequence[str]) -> list[str]:
    """What is wrong with short renders of a case by these methods, guided wherever it can be done."""
    case = replace(CASES[name], size=(12, 9))
    (plain,) = pictures(case, "OFF", 15, [1])
    found = []
    for method in methods:
        (guided,) = pictures(case, method, 15, [1])
        ratio = guided.image.mean(dtype=np.float64) / plain.image.mean(dtype=np.float64)
        checks = {
            "is not finite": np.isfinite(guided.image).all(),
            "has lost samples": guided.reject_count == 0,
            f"has {ratio:.2f} of the light": 0.7 < ratio < 1.4,
            f"had to give up: {guided.notices}": not any("Guiding" in notice for notice in guided.notices),
        }
        found += [f"{method} {what}" for what, is_right in checks.items() if not is_right]
    return found


@pytest.mark.parametrize("name", BAD_MEDIA)
def test_bad_media_are_guided_without_a_loss(name: str) -> None:
    assert not wrong_in_media(name, ["AUTO", "VMM", "VMM_RIS", "TABLE_RIS"])


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", BAD_MEDIA)
def test_bad_media_are_guided_without_a_loss_by_trees_and_networks(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    draw_networks_at_random(monkeypatch)
    assert not wrong_in_media(name, ["SDTREE", "SDTREE_VARIANCE", *NETWORKS])


@pytest.mark.slow
@pytest.mark.parametrize("name", WITH_HIDDEN_LIGHTS)
def test_learned_light_selection_is_unbiased(name: str, references: References) -> None:
    picture = pictures(CASES[name], "VMM", 31, [1])[0]
    assert any(line.startswith("lights: ") and not line.startswith("lights: 0%") for line in picture.guiding)
    assert not problems(CASES[name], ["VMM"], references(CASES[name]))


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", [name for name in IN_TIME if name not in FAST])
def test_statistical_methods_are_unbiased_in_every_case(name: str, references: References) -> None:
    assert not problems(CASES[name], SOME_STATISTICAL[name], references(CASES[name]))


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("method", every(["SDTREE_VARIANCE", "SDTREE"], 2))
def test_trees_forced_on_many_reflections_are_unbiased(method: str, references: References) -> None:
    """What a vertex lost would be lost at each of them, and show in the product of their weights."""
    case = CASES["albedo"]
    expected = references(case)
    description, base = describe_case(case, threads=1)
    settings = method_settings(method, base, forced=True)
    images = [render_case(description, replace(settings, seed=seed)).image for seed in range(1, 201)]
    bias = find_bias(images, expected)
    assert not bias.is_biased, bias
    assert bias.detectable < LEAST_BIAS, bias
    assert detects(images, expected, LEAST_BIAS) and detects(images, expected, -LEAST_BIAS)


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize("name", some_of((name for name in IN_TIME if name not in LONG_FOR_NETWORKS), 2))
def test_networks_that_know_nothing_are_unbiased(
    name: str, references: References, monkeypatch: pytest.MonkeyPatch
) -> None:
    draw_networks_at_random(monkeypatch)
    assert not problems(CASES[name], SOME_NETWORKS[name], references(CASES[name]))


@pytest.mark.slow
@pytest.mark.one_of_many
@pytest.mark.parametrize(
    ("name", "method"), list(zip(("keyhole", "colors", "thin", "late-caustic", "roughness-0.1"), NETWORKS, strict=True))
)
def test_networks_that_have_learned_are_unbiased(name: str, method: str, references: References) -> None:
    require_torch()

    assert not problems(CASES[name], [method], references(CASES[name]))


def noise(shape: tuple[int, int] = (36, 48), spread: float = 0.3, seed: int = 0, bias: float = 0.0) -> Float32Array:
    """A picture of light and dark parts with exponentially distributed noise."""
    base = np.random.default_rng(99).uniform(0.05, 2.0, (*shape, 3))
    random = np.random.default_rng((seed, 5)).exponential(1.0, (*shape, 3)) - 1.0
    return (base * (1.0 + spread * random) * (1.0 + bias)).astype(np.float32)


def test_a_bias_is_found_as_often_as_promised() -> None:
    references = [noise(spread=0.05, seed=1000 + k) for k in range(4)]
    trials = [[noise(seed=2 * k), noise(seed=2 * k + 1)] for k in range(200)]
    detectable = find_bias(trials[0], references).detectable
    found = [detects(images, references, detectable) for images in trials]
    # 95% and more: parts of the picture are looked at as well. Four standard deviations of 200 trials are 6%.
    assert np.mean(found) > 0.95 - 0.06
    # 200 pictures without bias: fewer than one false alarm in fifty choices of seeds.
    assert SIGNIFICANCE == 1e-4 and not any(find_bias(images, references).is_biased for images in trials)


def test_a_bias_of_one_cell_or_channel_is_found() -> None:
    references = [noise(spread=0.05, seed=1000 + k) for k in range(4)]
    images = [noise(spread=0.1, seed=k) for k in range(2)]
    for image in images:
        image[:9, 12:24] *= 1.05
    bias = find_bias(images, references)
    assert bias.is_biased and bias.worst_part == "cell (1, 0)"
    assert bias.worst_difference == pytest.approx(0.05, abs=0.02)
    images = [noise(spread=0.1, seed=k) * np.array((1.0, 1.03, 0.97), np.float32) for k in range(2)]
    bias = find_bias(images, references)
    assert bias.is_biased and bias.worst_part in "GB" and bias.z < MEAN_LIMIT


def test_pictures_that_are_no_numbers_are_biased() -> None:
    references = [noise(seed=1000 + k) for k in range(4)]
    images = [noise(seed=k) for k in range(2)]
    images[1][3, 4, 0] = np.nan
    assert find_bias(images, references).is_biased
    black = [np.zeros((36, 48, 3), np.float32)] * 2
    assert find_bias(black, references).is_biased and not find_bias(black, black).is_biased


def test_variance_ratios_are_those_planted() -> None:
    base = np.mean([noise(seed=k) for k in range(50)], axis=0)
    ratio, error, whole = variance_ratio(
        [noise(spread=0.42, seed=k) for k in range(4)], [noise(spread=0.3, seed=100 + k) for k in range(4)], base
    )
    assert ratio == pytest.approx(1.96, abs=4.0 * error) and 0.01 < error < 0.15
    assert whole == pytest.approx(1.96, rel=0.2)


def test_a_cached_image_is_judged_by_its_total_error() -> None:
    """A picture a half too bright, but with less noise: biased without a cache, with one as bad as its error is."""
    references = [noise(spread=0.05, seed=1000 + k) for k in range(4)]
    plain = [Picture(noise(seed=k), 1.0, 1, 0) for k in range(4)]
    bright = [Picture(noise(spread=0.15, seed=10 + k, bias=0.5), 1.0, 1, 0) for k in range(4)]
    _, unbiased, cached = evaluate("case", {"OFF": plain, "VMM": bright, "VMM-FAST": bright}, references)
    assert unbiased.problems == ["biased"] and unbiased.error < 0.8
    assert cached.problems == ["noisier"] and cached.error > 2.0


def test_every_method_is_covered_and_forced_to_guide() -> None:
    assert set(STATISTICAL) | set(NETWORKS) | {"OFF"} == set(METHODS)
    for method in METHODS:
        forced = method_settings(method, RenderSettings(), forced=True)
        assert forced.guiding_method == method and forced.deterministic
        assert forced.guiding_trial == (method == "OFF")
        assert method_settings(method, RenderSettings(), forced=False).guiding_trial
        assert method_settings(method, RenderSettings(), forced=False).radiance_cache == "OFF"
    cached = method_settings("VMM-CONVERGING", RenderSettings(), forced=False)
    assert (cached.guiding_method, cached.radiance_cache) == ("VMM", "CONVERGING")


def test_cases_have_scenes_and_sentences() -> None:
    from benchmarks.scenes import SCENES

    assert len(CASES) >= 26
    for case in CASES.values():
        assert case.scene in SCENES and case.purpose.count(" ") > 4, case.name
    assert {name for name in SCENES if name.startswith("fail-")} == {case.scene for case in CASES.values()}
    assert [case.name for case in find_cases(["few-*", "fail-thin"])] == ["few-1", "few-2", "few-4", "few-8", "thin"]
    with pytest.raises(ValueError, match="no case 'thick'"):
        find_cases(["thick"])


@pytest.mark.parametrize("scale", ["1e-4", "1e6"])
def test_scales_and_offsets_show_the_same_picture(scale: str) -> None:
    """Unguided, beyond noise: within 0.2% at other scales, 0.5% far away, where positions are a millimetre apart."""
    images = {
        name: [p.image for p in pictures(replace(CASES[name], size=(24, 18)), "OFF", 63, seeds)]
        for name, seeds in (("scale-1", range(4)), (f"scale-{scale}", range(4, 8)), ("offset-1e4", range(8, 12)))
    }
    for name, allowed in ((f"scale-{scale}", 0.002), ("offset-1e4", 0.005)):
        difference, error = metrics.compare_means(images[name], images["scale-1"])
        assert (np.abs(difference) < allowed + MEAN_LIMIT * error).all(), (name, difference, error)


def test_lights_are_sampled_as_ever_while_nothing_is_known_of_them() -> None:
    """Nothing but the share of light samples differs from unguided rendering, and after one sample it must not.

    Records of the first iteration have no weights. Counted as worthless, they made the variance 3.9 times as large.
    """
    description, base = describe_case(CASES["few-2"], threads=1)
    guided = replace(
        method_settings("VMM", base, forced=True), guiding_probability=0.0, sample_weighting="UNIFORM"
    )
    images = [
        [render_case(description, replace(settings, seed=seed)).image for seed in (1, 2)] for settings in (guided, base)
    ]
    assert variance_ratio(*images, np.mean(images[1], axis=0))[0] == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("method", ["VMM", "SDTREE", "TABLE_RIS"])
def test_a_session_forgets_what_it_learned_at_another_size(method: str) -> None:
    case = replace(CASES["resolution"], size=(16, 12))
    (after,) = pictures(case, method, 15, [1])
    (fresh,) = pictures(replace(case, earlier_sizes=()), method, 15, [1])
    assert np.array_equal(after.image, fresh.image)


def test_the_command_writes_a_matrix_and_goes_on_where_it_was(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = ["stability", "few-1", "--methods", "VMM", "--seeds", "2", "--threads", "1", "--out", str(tmp_path)]
    assert main(arguments) == 0
    printed = capsys.readouterr().out
    assert "| few-1 |" in printed and "rejects" in printed
    summary = json.loads((tmp_path / "chosen.json").read_text(encoding="utf-8"))
    assert [result["method"] for result in summary["results"]] == ["OFF", "VMM"]
    assert summary["results"][1]["bias"]["detectable"] < LEAST_BIAS and not summary["results"][1]["is_biased"]
    page = (tmp_path / "chosen.html").read_text(encoding="utf-8")
    assert CASES["few-1"].purpose in page and "data:image/png" in page and "finds a bias of" in page
    assert main(arguments) == 0
    assert "_seed1" not in capsys.readouterr().out
    # A render that was cut off, or answers another question, is repeated.
    (tmp_path / "chosen" / "few-1" / "VMM_seed1.npz").write_bytes(b"PK")
    assert main([*arguments, "--forced"]) == main(arguments) == 0
    printed = capsys.readouterr().out
    assert "forced/few-1/VMM_seed2" in printed and "chosen/few-1/VMM_seed1" in printed
    assert "chosen/few-1/VMM_seed2" not in printed and "reference" not in printed


def test_bad_arguments_of_stability_are_explained(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["stability", "thick"]) == 2
    assert "no case 'thick'" in capsys.readouterr().err
    assert main(["stability", "few-1", "--seeds", "1"]) == 2
    assert "at least 2 seeds" in capsys.readouterr().err


def test_problems_are_named() -> None:
    def rendered(bias: float, spread: float, **facts: object) -> list[Picture]:
        return [Picture(noise(spread=spread, seed=k, bias=bias), 1.0, 1, 0, **facts) for k in range(3)]  # type: ignore

    references = [noise(spread=0.05, seed=1000 + k) for k in range(4)]
    results = evaluate(
        "case",
        {
            "OFF": rendered(0.0, 0.1), "VMM": rendered(0.03, 0.1), "SDTREE": rendered(0.0, 0.15),
            "NPM": rendered(0.0, 3.0), "FLOW": rendered(0.0, 0.1, notices=["Guiding / FLOW: gone"]),
        },
        references,
    )  # fmt: skip
    assert [r.problems for r in results] == [[], ["biased"], ["noisier"], ["noisier", "blind"], ["noticed"]]
    assert measure_case.__doc__ and results[2].variance == pytest.approx(2.25, abs=0.3)
