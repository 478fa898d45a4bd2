# SPDX-License-Identifier: GPL-3.0-or-later
"""What a render says of guiding: to those who render in a sentence, to those who measure in lines."""

from __future__ import annotations

import math
from typing import Any

import pytest

from engine.guiding.models.report import GuidingReport


@pytest.mark.parametrize(
    ("facts", "sentence"),
    [
        ({"method": "AUTO", "chosen": "VMM", "efficiency": 6.08}, "Guiding paid: 6.1 times less noise than without"),
        ({"method": "VMM", "chosen": "VMM", "efficiency": 1.4}, "Guiding paid: 1.4 times less noise than without"),
        (
            {"method": "AUTO", "chosen": "OFF", "efficiency": 0.7, "stopped_at": 32},
            "Guiding did not pay here and was switched off after 32 samples",
        ),
        (
            {"method": "VMM_RIS", "chosen": "VMM_RIS", "efficiency": 0.7, "stopped_at": 8},
            "Guiding did not pay here and was switched off after 8 samples",
        ),
        (
            {"method": "AUTO", "chosen": "VMM", "efficiency": 1.01},
            "Guiding made no difference: about as much noise as without",
        ),
        (
            {"method": "VMM", "chosen": "VMM", "efficiency": math.nan},
            "Guiding was on, and was not compared with going without",
        ),
        ({"method": "OFF"}, ""),
    ],
)
def test_artists_read_whether_guiding_paid(facts: dict[str, Any], sentence: str) -> None:
    report = GuidingReport(**facts)
    report.describe({"shade": 1.0})
    assert report.sentence == sentence
    # Whoever measures reads the figures as before.
    assert report.lines and sentence not in report.lines


def test_a_render_that_is_over_too_soon_says_so() -> None:
    report = GuidingReport(method="AUTO")
    report.describe_left_out()
    assert report.chosen == "OFF"
    assert report.sentence == "Rendered without guiding: so few samples are over before it could pay"


@pytest.mark.parametrize(
    ("facts", "words"),
    [
        ({"cache_bias": 0.004}, ("40% of the paths could end", "off by about 0.4%", "vanishes with more samples")),
        ({"cache_bias": 0.004, "cache_stopped_at": 15}, ("did not pay", "from sample 16 on")),
        ({}, ("What that lacks is missing",)),
    ],
)
def test_artists_read_that_paths_ended_early_and_what_that_leaves(facts: dict[str, Any], words: tuple[str]) -> None:
    report = GuidingReport(**facts)
    report.describe_cache((0.3, 0.1, 0.0))
    assert all(some in report.cache_sentence for some in words) and "30% after one" in report.lines[-1]


def test_an_automatic_cache_says_why_it_was_left_out() -> None:
    report = GuidingReport()
    report.describe_no_cache("it knows no wavelengths")
    assert "it knows no wavelengths" in report.cache_sentence and "it knows no wavelengths" in report.lines[-1]
