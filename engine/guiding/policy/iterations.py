# SPDX-License-Identifier: GPL-3.0-or-later
"""How long iterations are, what their samples weigh, and how many paths they record."""

from __future__ import annotations

import math
from itertools import chain, repeat

from engine.guiding.policy.rules import RULES, Rules
from engine.guiding.records.vertices import RECORD_ROWS
from engine.settings import RenderSettings


def iteration_lengths(samples: int, rules: Rules = RULES) -> list[int]:
    """Samples a pixel of each iteration: few at first, doubling to the longest.

    After Rath et al. 2025, section 5.1, whose iterations are of 1, 2, 4, ... 16 samples. Here they begin where powers
    of two do, so that each has whole pieces of a pixel's Sobol sequence, and so has what a comparison divides. What
    would be left for a last short one is added to the one before: nothing learned for so few samples is won back.
    """
    lengths: list[int] = []
    left = samples
    for length in chain(rules.first_iterations, repeat(rules.longest_iteration)):
        if left <= 0:
            break
        lengths.append(min(length, left))
        left -= lengths[-1]
    if len(lengths) > len(rules.first_iterations) and lengths[-1] < rules.least_last_iteration:
        lengths[-2:] = [sum(lengths[-2:])]
    return lengths


def iteration_weight(
    first_sample: int, settings: RenderSettings, known_samples: float = 0.0, rules: Rules = RULES
) -> float:
    """Weight of each sample of the iteration that begins with `first_sample`.

    What the render started from was learned from `known_samples` a pixel, which count as seen.

    Early iterations knew little: their samples count less, in proportion to what had been seen when they were taken.
    Where nothing but the radiance cache learns, the square root of that is enough: what the camera sees is never
    sampled better than at first, and a cache of no use costs an image of 8 samples a twelfth of them, not a quarter.
    """
    if settings.sample_weighting == "UNIFORM" or not (settings.is_guided or settings.radiance_cache != "OFF"):
        return 1.0
    share = min((known_samples + first_sample + 1) / rules.full_weight_samples, 1.0)
    return share if settings.is_guided else math.sqrt(share)


def is_narrow(pixel_count: int, all_pixels: int, rules: Rules = RULES) -> bool:
    """Whether a noise threshold has left so few pixels that methods are not compared and learning rests at times."""
    return pixel_count < rules.narrow_share * all_pixels


class LearningRests:
    """Which iterations nothing is learned from, once few pixels are left.

    Learning takes its time however few paths there were, and all threads wait for it. So it comes when as many paths
    have been traced as half an iteration of the whole image has.

    Parameters
    ----------
    all_pixels : int
    rules : Rules
    """

    def __init__(self, all_pixels: int, rules: Rules = RULES) -> None:
        self._rules = rules
        self._all_pixels = all_pixels
        self._paths = 0

    def take(self, pixel_count: int, samples: int) -> bool:
        """Take the next iteration; True if nothing is to be learned from it, so that it need not record."""
        self._paths += pixel_count * samples
        enough = self._rules.narrow_share * self._rules.longest_iteration * self._all_pixels
        rests = is_narrow(pixel_count, self._all_pixels, self._rules) and self._paths < enough
        if not rests:
            self._paths = 0
        return rests


class RecordBudget:
    """How many of an iteration's paths are recorded.

    Parameters
    ----------
    paths_per_sample : int
        Pixels that are rendered.
    unit_pixels : int
        Pixels of the largest unit of work. Its records must fit (`RECORD_ROWS`): what does not fit is dropped.
    records_per_iteration : int, optional
        What an iteration aims at; None: what the rules say.
    rules : Rules

    Attributes
    ----------
    paths_per_sample : int
    records_per_path : float
        Records of a path that is recorded, as far as is known.
    is_frugal : bool
        Whether few are wanted, since nobody knows yet whether what is learned pays.
    samples_to_come : float or None
        Samples a pixel behind the iteration, by whose number records are wanted; None: nobody knows how many.
    is_for_image : bool
        Whether those samples alone go by what is recorded. Else some of it has another use, as teaching a network, and
        is wanted however little of the render is to come.
    """

    def __init__(
        self, paths_per_sample: int, unit_pixels: int, records_per_iteration: int | None = None, rules: Rules = RULES
    ) -> None:
        self._rules = rules
        self.paths_per_sample = paths_per_sample
        self._wanted = rules.records_per_iteration if records_per_iteration is None else records_per_iteration
        self._unit_pixels = unit_pixels
        self.records_per_path = rules.expected_records_per_path
        self.is_frugal = False
        self.samples_to_come: float | None = None
        self.is_for_image = False

    def count(self, record_count: int, path_count: float) -> None:
        """Take how many records came of so many recorded paths, those included that there was no room for."""
        self.records_per_path = max(record_count / max(path_count, 1.0), 0.01)

    def threshold(self, samples: float, pixel_share: float = 1.0) -> int:
        """Paths whose hash is below are recorded, of an iteration of so many guided samples a pixel: 2**32 is all.

        `pixel_share` is that of the pixels which have guided samples.
        """
        rules = self._rules
        expected = self.records_per_path * samples
        of_image = max(expected * self.paths_per_sample * pixel_share, 1.0)
        wanted: float = self._wanted
        if self.is_frugal:
            of_render = rules.few_per_path_left * (self.samples_to_come or 0.0) * self.paths_per_sample
            wanted = min(wanted, max(rules.few_records, rules.few_share * of_image, of_render))
        if self.is_for_image and self.samples_to_come is not None:
            # Something is to come, whatever was expected: of the last iteration nobody asks.
            of_rest = rules.records_per_path_left * max(self.samples_to_come, 1.0) * self.paths_per_sample
            wanted = min(wanted, max(rules.few_records, of_rest))
        share = min(
            wanted / of_image,
            rules.fullest_unit * RECORD_ROWS / max(expected * self._unit_pixels, 1.0),
        )
        return int(min(share, 1.0) * 2**32)
