# SPDX-License-Identifier: GPL-3.0-or-later
"""Light groups mixed after a render: sums of arrays, and factors that make no sense."""

from __future__ import annotations

import numpy as np
import pytest

from engine.render.light_mix import (
    changes,
    checked_factors,
    missing_groups,
    mixed,
    mixed_denoised,
    without_background,
)

SHAPE = (3, 5)


def picture_of(groups: dict[str, np.ndarray], rest: float = 0.0) -> np.ndarray:
    """The groups' sum, light of no group, and an alpha."""
    picture = np.full((*SHAPE, 4), rest, np.float32)
    picture[..., :3] += sum(groups.values(), np.zeros((*SHAPE, 3), np.float32))
    picture[..., 3] = 0.25
    return picture


@pytest.fixture
def groups() -> dict[str, np.ndarray]:
    """Three groups, one of an odd name."""
    rng = np.random.default_rng(3)
    return {name: rng.random((*SHAPE, 3), np.float32) for name in ("Key", "Küche & Bad (2)/x", "Sky")}


def test_with_factors_of_one_the_picture_is_the_same_to_the_bit(groups: dict[str, np.ndarray]) -> None:
    picture = picture_of(groups, 0.1)
    same = mixed(picture, groups, dict.fromkeys(groups, (1.0, 1.0, 1.0)))
    assert np.array_equal(same, picture)
    assert not np.shares_memory(same, picture)


def test_factors_multiply_the_light_of_their_groups_alone(groups: dict[str, np.ndarray]) -> None:
    """Light of no group and alpha stay, and so does a group without a factor."""
    rest = 0.125
    factors = {"Key": (2.0, 0.5, 0.0), "Küche & Bad (2)/x": (0.0, 0.0, 0.0)}
    picture = picture_of(groups, rest)
    before = picture.copy()
    result = mixed(picture, groups, factors)
    expected = rest + groups["Key"] * np.float32(factors["Key"]) + groups["Sky"]
    np.testing.assert_allclose(result[..., :3], expected, rtol=1e-5, atol=1e-6)
    assert np.array_equal(result[..., 3], picture[..., 3])
    assert np.array_equal(picture, before)


def test_all_groups_off_leave_the_light_of_no_group(groups: dict[str, np.ndarray]) -> None:
    off = mixed(picture_of(groups, 0.5), groups, dict.fromkeys(groups, (0.0, 0.0, 0.0)))
    np.testing.assert_allclose(off[..., :3], 0.5, atol=1e-6)


def test_where_the_light_of_a_group_is_no_number_the_picture_stays(groups: dict[str, np.ndarray]) -> None:
    picture = picture_of(groups)
    groups["Key"][0, 0] = np.nan
    groups["Key"][1, 1, 2] = np.inf
    groups["Key"][2, 2, 0] = np.finfo(np.float32).max
    result = mixed(picture, groups, {"Key": (9.0, 9.0, 9.0)})
    assert np.isfinite(result).all()
    assert np.array_equal(result[0, 0], picture[0, 0])
    assert result[1, 1, 2] == picture[1, 1, 2]
    assert result[2, 2, 0] == picture[2, 2, 0]


@pytest.mark.parametrize(
    ("factor", "sentence"),
    [
        ((1.0, -0.5, 1.0), "light group Key: the factor 1, -0.5, 1 is negative"),
        ((1.0, float("nan"), 1.0), "light group Key: the factor 1, nan, 1 is NaN or too large"),
        ((1.0, float("inf"), 1.0), "NaN or too large"),
        ((1e300, 1.0, 1.0), "NaN or too large"),
        ((1.0, 1.0), "is not three numbers"),
        ("red", "is not three numbers"),
        (None, "is not three numbers"),
    ],
)
def test_factors_that_make_no_sense_are_refused_by_name(
    factor: object, sentence: str, groups: dict[str, np.ndarray]
) -> None:
    with pytest.raises(ValueError, match="light group Key") as caught:
        mixed(picture_of(groups), groups, {"Key": factor})  # type: ignore[dict-item]
    assert sentence in str(caught.value)


def test_groups_that_were_not_rendered_are_refused_only_where_the_mix_changes_them(
    groups: dict[str, np.ndarray]
) -> None:
    factors = {"Key": (2.0, 2.0, 2.0), "Fill": (1.0, 1.0, 1.0), "Rim": (0.0, 0.0, 0.0)}
    assert missing_groups(factors, groups) == ["Rim"]
    with pytest.raises(ValueError, match="light group Rim was not rendered, and is in the mix: there are Key, "):
        mixed(picture_of(groups), groups, factors)
    with pytest.raises(ValueError, match="none were"):
        mixed(picture_of({}), {}, factors)
    del factors["Rim"]
    mixed(picture_of(groups), groups, factors)


def test_a_group_of_another_size_is_refused(groups: dict[str, np.ndarray]) -> None:
    groups["Sky"] = groups["Sky"][:2]
    with pytest.raises(ValueError, match="light group Sky has 5 x 2 pixels, and the picture 5 x 3"):
        mixed(np.zeros((*SHAPE, 4), np.float32), groups, {"Sky": (2.0, 2.0, 2.0)})


def test_what_a_mix_changes() -> None:
    checked = checked_factors({"A": (1, 1, 1), "B": (1, 1, 0.5), "C": (2, 2, 2)})
    assert changes(checked) == ["B", "C"]
    assert all(value.dtype == np.float32 for value in checked.values())


def test_the_background_that_a_transparent_film_leaves_out_is_not_mixed(groups: dict[str, np.ndarray]) -> None:
    environment = np.full((*SHAPE, 3), 0.75, np.float32)
    picture = picture_of(groups)
    groups["Sky"] = groups["Sky"] + environment
    groups["Sky"] = without_background(groups["Sky"], environment)
    off = mixed(picture, groups, {"Sky": (0.0, 0.0, 0.0)})
    np.testing.assert_allclose(off[..., :3], groups["Key"] + groups["Küche & Bad (2)/x"], rtol=1e-5, atol=1e-6)


def test_a_denoised_picture_gets_the_ratio_of_two_sums(groups: dict[str, np.ndarray]) -> None:
    """To the bit the same with factors of 1, and nowhere below zero, whatever the denoiser has made of the whole."""
    rest = 0.25
    plain = picture_of(groups, rest)[..., :3]
    denoised = np.concatenate((plain * np.float32(0.9), np.full((*SHAPE, 1), 0.5, np.float32)), axis=2)
    assert np.array_equal(mixed_denoised(denoised, plain, groups, {"Key": (1.0, 1.0, 1.0)}), denoised)
    off = mixed_denoised(denoised, plain, groups, {"Key": (0.0, 0.0, 0.0)})
    np.testing.assert_allclose(off[..., :3], 0.9 * (plain - groups["Key"]), rtol=0.02)
    assert np.array_equal(off[..., 3], denoised[..., 3])
    all_off = mixed_denoised(denoised, plain, groups, dict.fromkeys(groups, (0.0, 0.0, 0.0)))
    np.testing.assert_allclose(all_off[..., :3], 0.9 * rest, rtol=0.02)


def test_where_there_is_no_light_or_no_number_a_denoised_picture_stays(groups: dict[str, np.ndarray]) -> None:
    plain = picture_of(groups)[..., :3]
    for image in (plain, *groups.values()):
        image[0, 0] = 0.0
    plain[1, 1] = np.nan
    plain[2, 2] = np.inf
    denoised = np.full((*SHAPE, 3), 0.5, np.float32)
    result = mixed_denoised(denoised, plain, groups, dict.fromkeys(groups, (5.0, 5.0, 5.0)))
    for place in ((0, 0), (1, 1), (2, 2)):
        np.testing.assert_allclose(result[place], 0.5, rtol=1e-5)
    assert np.isfinite(result).all()
    black = np.zeros((*SHAPE, 3), np.float32)
    assert not mixed_denoised(black, black, {"Key": black}, {"Key": (9.0, 0.0, 1.0)}).any()
