# SPDX-License-Identifier: GPL-3.0-or-later
"""Frames are averaged along what moves, and along nothing else: no ghosts of what was hidden, or lit otherwise."""

import numpy as np
import pytest

from engine.denoise.motion import follow, offsets
from engine.denoise.temporal import Frame, steady

HEIGHT, WIDTH, REACH = 48, 64, 4
COUNT = 2 * REACH + 1
#: Standard deviations of sampled and of denoised pixels.
SAMPLED, DENOISED = 0.3, 0.08


def make_frames(truths, albedos=None, vectors=None, seed=0):
    """Frames of true pictures with noise as denoisers leave it."""
    rng = np.random.default_rng(seed)
    frames = []
    for index, truth in enumerate(truths):
        truth = np.asarray(truth, np.float32)
        noise = DENOISED * rng.standard_normal(truth.shape).astype(np.float32)
        albedo = np.full_like(truth, 0.5) if albedos is None else albedos[index]
        normal = np.zeros_like(truth)
        normal[..., 2] = 1.0
        motion = np.zeros((*truth.shape[:2], 4), np.float32) if vectors is None else vectors[index]
        frames.append(Frame(truth + noise, albedo, normal, motion, np.full_like(truth, SAMPLED**2)))
    return frames


def grey(value=1.0):
    return np.full((HEIGHT, WIDTH, 3), value, np.float32)


def steadied(frames, index=REACH, reach=REACH):
    return steady(frames.__getitem__, index, len(frames), reach)


def test_noise_of_what_stands_still_goes_with_the_root_of_the_frames():
    found = steadied(make_frames([grey()] * COUNT)) - 1.0
    assert found.std() == pytest.approx(DENOISED / np.sqrt(COUNT), rel=0.05)
    assert abs(found.mean()) < 0.002
    first = steadied(make_frames([grey()] * COUNT), index=0) - 1.0
    assert first.std() == pytest.approx(DENOISED / np.sqrt(REACH + 1), rel=0.05)


def test_a_texture_that_moves_is_followed_and_what_comes_in_sight_keeps_its_own_pixels():
    """All moves 3 pixels to the right and 1 up a frame, by Blender's vectors: back to the last, here from the next."""
    albedo = np.random.default_rng(1).uniform(0.2, 0.8, (HEIGHT + COUNT, WIDTH + 3 * COUNT, 1)).astype(np.float32)
    albedos = [
        np.repeat(albedo[COUNT - step : COUNT - step + HEIGHT, 3 * (COUNT - step) :][:, :WIDTH], 3, axis=2)
        for step in range(COUNT)
    ]
    vectors = np.broadcast_to(np.float32((-3.0, -1.0, -3.0, -1.0)), (HEIGHT, WIDTH, 4))
    frames = make_frames([2.0 * image for image in albedos], albedos, [vectors] * COUNT)
    error = steadied(frames) - 2.0 * albedos[REACH]
    # Everything here is seen in four frames at least.
    assert error[REACH:-REACH, 3 * REACH : -3 * REACH].std() < 1.15 * DENOISED / np.sqrt(COUNT)
    last = steadied(frames, index=COUNT - 1)
    assert np.array_equal(last[:, :3], frames[-1].picture[:, :3])
    assert np.array_equal(last[:1], frames[-1].picture[:1])


def test_what_an_object_uncovers_keeps_its_own_pixels():
    """A board in front moves 4 pixels to the left a frame; light and albedo are those of the wall behind it."""
    vectors, lefts = [], [40 - 4 * step for step in range(COUNT)]
    for left in lefts:
        motion = np.zeros((HEIGHT, WIDTH, 4), np.float32)
        motion[10:30, left : left + 16] = (4.0, 0.0, 4.0, 0.0)
        vectors.append(motion)
    frames = make_frames([grey()] * COUNT, vectors=vectors)
    # Looking back only: the last frame.
    found, own = steadied(frames, index=COUNT - 1), frames[-1].picture
    uncovered = (slice(10, 30), slice(lefts[-1] + 16, lefts[-2] + 16))
    assert np.array_equal(found[uncovered], own[uncovered])
    assert (found[:8] - 1.0).std() < 0.6 * DENOISED


def test_an_edge_out_of_focus_keeps_its_own_pixels():
    """Vectors blend from those of what moves in front into those of the wall behind; all looks alike."""
    motion = np.zeros((HEIGHT, WIDTH, 4), np.float32)
    motion[..., ::2] = np.clip((np.arange(WIDTH) - 28.0) / 4.0, 0.0, 2.0)[:, None]
    frames = make_frames([grey()] * COUNT, vectors=[motion] * COUNT)
    found, own = steadied(frames), frames[REACH].picture
    assert np.array_equal(found[:, 30:34], own[:, 30:34])
    assert (found[:, :20] - 1.0).std() < 0.5 * DENOISED


@pytest.mark.parametrize("before", [0.0, 0.9])
def test_a_lamp_that_is_switched_on_leaves_no_ghost(before):
    """Of a lamp that makes all lighter by a tenth, less than what noise leaves is seen a frame before and after."""
    frames = make_frames([grey(before)] * REACH + [grey()] * (REACH + 1))
    assert steadied(frames).mean() == pytest.approx(1.0, abs=0.02)
    assert steadied(frames, index=REACH - 1).mean() == pytest.approx(before, abs=0.02)
    # The frames of one side still help.
    assert (steadied(frames) - 1.0).std() < 1.3 * DENOISED / np.sqrt(REACH + 1)


def test_a_shadow_that_moves_over_a_wall_leaves_no_trail():
    truths = []
    for step in range(COUNT):
        image = grey()
        image[:, 6 * step : 6 * step + 12] = 0.3
        truths.append(image)
    found, truth = steadied(make_frames(truths)), truths[REACH]
    edge = np.abs(np.arange(WIDTH) - 6 * REACH - 5.5) < 8.0
    assert np.abs((found - truth)[:, edge].mean(axis=(0, 2))).max() < 0.05
    assert found.std(axis=0)[~edge].mean() < 0.7 * DENOISED


def test_a_highlight_that_moves_over_a_wall_is_followed():
    """It moves a pixel every other frame, the wall does not: the frames beside it help, two of each side at least."""
    truths = []
    for step in range(COUNT):
        image = grey()
        image[20:28, 30 + step // 2 : 38 + step // 2] = np.linspace(1.0, 6.0, 8)[:, None]
        truths.append(image)
    within = (slice(21, 27), slice(30 + REACH // 2 + 1, 37 + REACH // 2))
    found = [(steadied(make_frames(truths, seed=seed)) - truths[REACH])[within] for seed in range(8)]
    assert np.std(found) < DENOISED / np.sqrt(3.0)
    assert abs(np.mean(found)) < 0.25 * DENOISED


def test_what_is_no_number_is_taken_to_stand_still_and_pixels_that_leave_the_picture_are_lost():
    vectors = np.full((4, 6, 4), np.nan, np.float32)
    assert not offsets(vectors, 1).any()
    vectors[:] = (2.0, 0.0, -1.0, 3.0)
    assert np.array_equal(offsets(vectors, -1)[0, 0], (0.0, 2.0))
    assert np.array_equal(offsets(vectors, 1)[0, 0], (-3.0, 1.0))
    vectors[:] = (1e30, 1e30, 0.0, 0.0)
    (sighting,) = follow(lambda _: vectors, 1, 0, -1)
    assert not sighting.is_seen.any()
