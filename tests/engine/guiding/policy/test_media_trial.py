# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether surfaces and media are guided together or one of them alone, given what comparisons find."""

import numpy as np

from engine.guiding.policy.questions.media import MediaTrial
from engine.guiding.policy.way import BOTH, MEDIA, SURFACES
from engine.state.film import allocate_tile
from engine.state.unit import CHALLENGER, Unit

#: Of an iteration: so many that variances tell efficiencies to a thousandth.
SAMPLES = 1 << 14
WEIGHTS = np.ones(1, np.float32)


def run(worth, iterations=20, is_free=lambda iteration: True):
    """A trial after so many iterations in which what is guided is worth what `worth` says."""
    media = MediaTrial(1)
    first, said, history = 1, [], []
    for iteration in range(iterations):
        if media.is_running:
            for arm_samples in media.arms:
                guided = media.challenger if arm_samples.arm == CHALLENGER else media.guided
                unit = Unit(np.zeros((1, 2), np.int32), np.zeros(1, np.int64), *arm_samples)
                tile = allocate_tile(1, 3)
                tile.square[:] = arm_samples.sample_count / worth[guided]
                media.compare(unit, tile, arm_samples.sample_count)
        sentence = media.judge(WEIGHTS, first)
        said += [sentence] if sentence else []
        media.plan(first, SAMPLES, is_free=is_free(iteration))
        history.append(media.challenger if media.is_running else "")
        first += SAMPLES
    return media, said, history


def test_what_does_not_pay_is_left_out():
    assert run({BOTH: 1.0, SURFACES: 2.0, MEDIA: 0.5})[0].guided == SURFACES
    assert run({BOTH: 1.0, SURFACES: 0.5, MEDIA: 2.0})[0].guided == MEDIA


def test_where_both_pay_both_stay_and_are_compared_again_later():
    media, said, history = run({BOTH: 1.0, SURFACES: 0.5, MEDIA: 0.5})
    assert media.guided == BOTH
    assert said[0] == f"guiding {SURFACES} over {BOTH} 0.50 at sample {1 + SAMPLES}"
    assert history[:3] == [SURFACES, MEDIA, ""]
    again = [index for index, challenger in enumerate(history) if challenger][2]
    assert again >= 8


def test_a_small_difference_takes_three_comparisons():
    media, said, history = run({BOTH: 1.0, SURFACES: 1.04, MEDIA: 1.0})
    assert media.guided == SURFACES and len(said) == 1
    assert history[:4] == [SURFACES, SURFACES, SURFACES, ""]


def test_nothing_is_compared_while_something_else_is_or_of_few_samples():
    _, said, history = run({BOTH: 1.0, SURFACES: 2.0, MEDIA: 2.0}, is_free=lambda iteration: False)
    assert not said and not any(history)
    media = MediaTrial(1)
    media.plan(0, 3, is_free=True)
    assert not media.is_running


def test_a_comparison_that_was_interrupted_goes_on():
    media, said, history = run({BOTH: 1.0, SURFACES: 1.2, MEDIA: 1.0}, is_free=lambda iteration: iteration % 2 == 0)
    assert history[:3] == [SURFACES, "", SURFACES]
    assert media.guided == SURFACES and len(said) == 1


def test_what_lost_is_guided_in_part_before_it_is_given_up():
    media = MediaTrial(1)
    guided = [media.guided]
    while media.fall_back():
        guided.append(media.guided)
    assert guided == [BOTH, MEDIA, SURFACES]
