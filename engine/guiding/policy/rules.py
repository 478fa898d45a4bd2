# SPDX-License-Identifier: GPL-3.0-or-later
"""The numbers that decide what is learned, compared and kept, with the pages of docs/decisions that measured them."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType


def _by_iteration(values: Mapping[int, float]) -> Mapping[int, float]:
    return field(default_factory=lambda: MappingProxyType(dict(values)))  # type: ignore[return-value]


@dataclass(frozen=True)
class Rules:
    """Numbers that the learner goes by; all have a default, which is what renders use. Tests pass others."""

    # -- Is guiding worth it? docs/decisions/trial-and-choice.md

    #: Iterations that compare guiding with unguided rendering, by index, and the least efficiency over it with which
    #: guiding goes on after them. It still learns, and at first gets the benefit of the doubt. In the end it has to be
    #: better by more than one: samples of unguided rendering are better spread over a pixel, which the variance of
    #: single ones does not show.
    least_efficiency: Mapping[int, float] = _by_iteration({2: 0.5, 3: 0.5, 4: 0.8, 5: 1.0, 6: 1.3})
    #: Where at most so many times the samples taken are left, nothing gets the benefit of the doubt: no later part of
    #: the render could pay for it. A trial so costs the same share of a short render as of a long one.
    short_rest: float = 7
    least_of_short: float = 1.25
    #: On a quarter of the pixels the first comparison knows few bright unguided samples, and shows guiding worse than
    #: it is; but to go on costs little there.
    least_of_first_part: float = 1.0
    #: Where more than so many times the samples taken are left, going on on a quarter of the pixels costs a thirtieth
    #: of the render at most, and the first comparisons have shown 0.4 where guiding came to 4 and 9.
    long_rest: float = 15
    least_of_long_part: float = 0.25
    #: From which it guides all pixels: below, it may be luck.
    sure_of_first_part: float = 1.5
    #: Efficiency that needs no more comparing for now; by two or three unguided samples a pixel it can be luck.
    clear_efficiency: Mapping[int, float] = _by_iteration({2: 2.0, 3: 2.0, 4: 1.35, 5: 1.35, 6: 1.35})
    #: What guiding has won against is compared with it again at so many times the samples, and so is a method that
    #: lost, by so many iterations together: one lucky comparison must not bind an easy scene for good. Not where it is
    #: `sure` times as good; below `least_later` it is left.
    again: int = 4
    looks: int = 3
    sure: float = 2.5
    least_later: float = 1.0
    #: Where guiding has won in the render that this one starts from, it is not compared before so many samples.
    look_again_from: int = 32
    #: Largest share of an image's variance that a single pixel may have. Nothing is left out: where guiding is worth
    #: the most, unguided rendering hides its variance in few bright samples.
    outlier_share: float = 0.05
    #: What an iteration's guided samples count for in the next iteration's variance. Those of a guide that knew little
    #: can have a hundred times the variance, and must be forgotten sooner than what regions have learned.
    variance_decay: float = 0.4
    #: Least share of a variance that is left when it is taken about a mean of the same samples: with n samples of equal
    #: weight the share is (n - 1) / n. Less tells nothing.
    least_left: float = 0.4

    #: A network that directions are drawn from begins to guide once it has been trained by so many steps (of 4096
    #: records), or has nothing more to learn from: with 6 to 25 steps it had 0.2 to 0.6 of the efficiency of unguided
    #: rendering, and spoiled what the mixture field learned from.
    source_least_steps: int = 64
    #: It is asked for as little as after a first comparison until it has been trained by so many steps, or has nothing
    #: more to learn from; for this share of what was left when it began to guide at most.
    source_doubtful_steps: int = 256
    source_doubtful_share: float = 0.25

    #: An iteration of fewer samples a pixel compares nothing.
    least_compared: int = 4

    # -- Where there are media. docs/decisions/guiding-in-media.md

    #: Samples before anything is learned. To learn twice costs twice as much, and samples guided by what the first one
    #: has left are worth little.
    cautious_samples: int = 4
    #: Where guides have learned from unguided samples alone by then, they are worse than they will be. What pays later
    #: had 0.85 and more of the efficiency in them, most of what does not 0.6 and less.
    least_of_cautious: float = 0.75
    #: What regions have to promise for guiding to be tried on where a comparison has shown it to lose: where it pays
    #: they promise 1.2 to 3.7, where it does not 1 to 1.06.
    least_promise: float = 1.1
    #: And what both surfaces and media have to promise for all pixels to be guided, though a comparison of a part of
    #: them has shown little.
    sure_promise: float = 1.4

    # -- Which method? docs/decisions/trial-and-choice.md

    #: Mean efficiency of a challenger over what is in use at or below which it is dropped, and from which on it is
    #: taken, after so many comparisons. Variances of a few samples a pixel tell efficiencies to about a tenth.
    dropped: tuple[float, ...] = (0.8, 0.95, 1.03)
    taken: tuple[float, ...] = (1.5, 1.15, 1.03)
    #: Resampling is worth it once in so many iterations running this share of the vertices was worth several
    #: candidates (docs/decisions/candidates.md).
    resampling_patience: int = 2
    least_resampled: float = 0.1
    #: Iterations that a table learns from before AUTO tries it.
    table_updates: int = 3
    #: Costs in rays where no clock may be asked: of guiding a vertex, and a factor for learning.
    guided_cost: float = 1.0
    learning_cost: float = 1.15
    #: Share of the guided vertices from which on resampling is measured: of a few candidates at a time a network's cost
    #: is that of the calls.
    least_measured: float = 0.2

    # -- Is a network worth it? docs/decisions/radiance-network.md

    #: What a render must still take for training beside it to begin at all: seconds or, without a clock, paths.
    least_time_left: float = 20.0
    least_paths_left: float = 6e6
    #: How many times as long as for who asks for a network a render must be for AUTO to try one: no network has won at
    #: equal time on a processor, and to start and train one takes about eight seconds of a thread.
    auto_caution: float = 5.0
    #: Training begins after so many samples a pixel: before, records are few, and what guides changes with each
    #: iteration.
    network_from: int = 15
    #: A network is on trial from its first snapshot on, for this share of what is left then, but for as long as it
    #: takes to learn and be judged: seconds or, without a clock, samples. It is not given up before it has been trained
    #: by so many steps, or has nothing more to learn from, and been looked at `network_looks` times; but after
    #: `network_longest_share` of what was left it is.
    network_trial_share: float = 0.1
    network_longest_share: float = 0.25
    network_least_seconds: float = 2.0
    network_least_samples: int = 64
    network_trial_steps: int = 128
    #: Training of a network that is kept ends after this share of the render, as the paper's mixtures have it (Dong et
    #: al. 2023, section 5.2): what it has learned has to pay for itself in what is left.
    network_trained_share: float = 0.25
    #: Figures that decide together: each is of one iteration's records.
    network_looks: int = 3
    #: Mean promised efficiency, over going on without, from which on a network is kept, and below which it is given up
    #: again. A promise is an estimate, and training takes time from all paths.
    network_kept: float = 1.05
    network_given_up: float = 1.02
    #: Records that are looked at of an iteration, evenly spread.
    held_out_records: int = 1 << 16
    #: Records that the image's ratio of moments stands for in each region. Of what few records say by chance the best
    #: regions would be chosen, and every predictor would promise something.
    held_out_prior: float = 24.0

    # -- Roulette and light sampling. docs/decisions/roulette-and-light-sampling.md

    #: By how much longer paths live than the theory says, and the least probability of going on: estimates are
    #: uncertain, and ending paths that mattered costs more than tracing some that do not.
    roulette_factor: float = 2.0
    roulette_least: float = 0.1
    #: What a look-up at every surface costs, where rays are counted instead of seconds.
    roulette_counted_overhead: float = 1.08
    #: Efficiency over roulette by the throughput from which on it goes on: a few samples tell it to a tenth or two, and
    #: it wins by more than it loses.
    roulette_least_efficiency: float = 0.9
    #: Of a variance about a mean of the same samples, the share that must not be in that mean.
    roulette_least_left: float = 0.2
    #: Of larger pictures the samples that nothing guides, while guiding is tried on others, are not kept to judge
    #: roulette by: their moments take forty bytes a pixel.
    roulette_most_pixels: int = 1 << 22
    #: Samples a pixel from which on nothing more is learned without guiding; of lights, if by the first number nothing
    #: was found to pay.
    learned_samples: int = 16
    lights_samples: int = 32
    #: Records that an iteration aims at until then, and the share of all paths of the render that so many may be where
    #: lights are learned: a recorded path costs two or three others, and in a short render that is not won back.
    unguided_records: int = 1 << 15
    unguided_records_share: float = 1.0 / 32.0

    # -- Is the radiance cache worth it? docs/decisions/radiance-cache.md

    #: Least share of the paths that go on where they could end, and measure what the cache lacks.
    cache_measured_share: float = 0.125
    #: Most of the paths that record for a guide, and so go on and measure too, once cells say something.
    cache_recorded_share: float = 0.25
    #: The share is judged again at so many times the samples.
    cache_again: float = 1.5
    #: The cache is given up where a picture has so many times the error at equal cost that it would have without: by
    #: one look, or by the product of those since it last paid. Few samples tell it to a fifth.
    cache_lost: float = 2.25
    #: It is given up sooner after so many looks in which it did not pay.
    cache_lost_slowly: float = 1.15
    cache_looks: int = 3
    #: What asking and teaching cells costs, as a factor of what paths cost.
    cache_cost: float = 1.1
    #: It is given up at once, too, where what it lacks in the large is surely more than this share of what it says, as
    #: squares, and more than the noise of an image without it: of details of such a lie too little is known in time.
    #: Single bright paths make standard errors that are too small by twice themselves or more; gross lies stand out by
    #: ten.
    cache_wrong: float = 0.1
    cache_sure: float = 8.0
    #: More paths measure as soon as so many times what is surely lacking in the large is more than the image's noise.
    cache_ahead: float = 4.0
    #: Standard errors by which what is lacking still must be more than none, before it speaks against the cache.
    cache_doubt: float = 2.0
    #: Percentage of the pixels whose squares are cut to the next smaller one: single bright paths would decide.
    cache_cut_percent: float = 0.1
    #: Samples a pixel before which more of them may: nothing is known yet, and the records teach all the sooner.
    cache_early_samples: int = 7

    # -- Iterations, their weights and their records. docs/decisions/trial-and-choice.md

    #: Samples a pixel of the first iterations, of the longest ones, and how long the last must be to be one of its own.
    first_iterations: tuple[int, ...] = (1, 3, 4, 8)
    longest_iteration: int = 16
    least_last_iteration: int = 8
    #: Samples a pixel after which an iteration counts fully.
    full_weight_samples: int = 8
    #: Weight in the image of a sample that was taken to compare, where weights grow with the samples seen
    #: (`engine.guiding.policy.iterations.iteration_weight`): where guiding is worth having, it is a bad one.
    plain_weight: float = 0.5
    #: Where guiding is tried an unguided sample weighs one, so that none is lost where guiding loses, and a guided one
    #: so much from this sample on: until then guides have learned from the first sample alone. Where guiding wins that
    #: one is worse than others by still more, and weighs half.
    guided_weight: float = 2.0
    guided_weight_from: int = 4
    first_weight: float = 0.5
    #: Weight of guided samples where guiding is tried cautiously: where it loses they have two to four times the
    #: variance of others, and where it wins they are few.
    cautious_weight: float = 0.5
    #: Records that an iteration aims at: what fitting and training can look at in the time they have.
    records_per_iteration: int = 1 << 18
    #: Until guiding has been found to pay: so many, or so large a share of all paths. To record a path and to learn
    #: from it costs as much as one or two others.
    few_records: int = 1 << 15
    few_share: float = 0.03
    #: In large or long renders so many for each path to come, if that is more: all later samples are drawn by what they
    #: have taught the guide.
    few_per_path_left: float = 0.02
    #: Records of an iteration for each path that is still to come after it: of few paths nothing learned is won back.
    records_per_path_left: float = 0.25
    #: Records of a recorded path, until it is known.
    expected_records_per_path: float = 4.0
    #: Share of the pixels below which few are left.
    narrow_share: float = 0.5
    #: Share of its memory that a unit's records are to fill on average: some tiles have longer paths than others.
    fullest_unit: float = 0.5
    #: Least share of all samples that the last iteration must have to be learned from once the render is over.
    least_last: float = 0.1


#: What renders go by.
RULES = Rules()
