# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that are interrupted and taken up: the same bits, or a sentence that says why the frame begins anew."""

import errno
import os
import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from engine.processes.file_locks import FileHold
from engine.render import checkpoint
from engine.render.checkpoint import Checkpoint, Identity
from engine.render.checkpoint_file import CheckpointError, load_checkpoint, load_film, save_checkpoint, sums_of
from engine.render.checkpointing import CheckpointRefused
from engine.render.film_addition import add_film
from engine.render.loop_state import LoopState
from engine.render.strata import StrataFilm
from engine.state.film import allocate_tile
from tests.helpers.frozen_folders import freeze
from tests.helpers.interrupted import Renderer
from tests.helpers.small_scenes import pit_scene, sun

PASSES = {"Combined", "Depth", "Normal", "Variance", "Sample Count", "CryptoObject00"}
#: Units of a render of the scene below by 40 samples are more than 20.
LATE = 17


@pytest.fixture
def path(tmp_path):
    return tmp_path / "x.ngcheckpoint"


def renderer(monkeypatch, path, strength=2.0, **settings):
    description = pit_scene(size=(70, 40))
    description.lights = [sun(strength)]
    return Renderer(monkeypatch, description, path, PASSES, **{"samples": 40, **settings})


def assert_same(result, other):
    assert result.passes.keys() == other.passes.keys()
    for name, image in result.passes.items():
        assert np.array_equal(image, other.passes[name]), name


#: The denoiser takes one thread, and so makes the same picture of the same film.
DENOISED = {"use_denoising": True, "denoised_threshold": 0.009, "denoising_quality": "FAST", "samples": 200}
NOISE = {"use_adaptive_sampling": True, "adaptive_threshold": 0.05, "adaptive_min_samples": 4, "samples": 64}


@pytest.mark.parametrize("settings", [{}, NOISE, DENOISED], ids=["plain", "noise threshold", "denoised threshold"])
def test_a_render_goes_on_to_the_same_bits(monkeypatch, path, settings):
    """Interrupted twice, at the beginning and later."""
    made = renderer(monkeypatch, path, **settings)
    whole = made.whole()
    counts = whole.passes["Sample Count"]
    if settings is NOISE:
        assert counts.min() < counts.max(), "the threshold is to drop some pixels"
    if settings is DENOISED:
        assert whole.report.ended_by == "DENOISED_THRESHOLD" and 40 < counts.max() < 200
    first = made.interrupted(5)
    assert first.report.cancelled and load_checkpoint(path).state.path_count == first.report.path_count
    second = made.interrupted(LATE, resumes=True)
    assert second.report.cancelled and made.resumed > 0
    last = made.taken_up()
    assert_same(last, whole)
    assert (last.report.ended_by, last.report.denoised_look) == (whole.report.ended_by, whole.report.denoised_look)
    assert made.notices == []


def test_films_of_strata_are_whole(path):
    film, rng = StrataFilm(3, 2, 4), np.random.default_rng(5)
    for tile in sums_of(film).values():
        for values in tile:
            values[:] = rng.random(values.shape) * 100
    save_checkpoint(path, Checkpoint(Identity("v", "s", "l", {}), LoopState(path_count=7), 3), sums_of(film))
    other = StrataFilm(3, 2, 4)
    load_film(path, other)
    for one, again in zip(sums_of(film).values(), sums_of(other).values(), strict=True):
        assert all(np.array_equal(*columns) for columns in zip(one, again, strict=True))
    with pytest.raises(CheckpointError, match=r"film\.radiance"):
        load_film(path, StrataFilm(4, 2, 4))


def test_the_film_is_kept_while_it_is_rendered(monkeypatch, path):
    """What a process leaves that is killed."""
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(LATE, interval=0.0)
    assert not list(path.parent.glob("*.part"))
    assert_same(made.taken_up(interval=0.0), whole)


@pytest.mark.parametrize("why", [{"interval": 1e9}, {"interval": 0.0, "most_rate": 1e-6}])
def test_renders_shorter_than_their_patience_leave_no_file(monkeypatch, path, why):
    """Nor do those whose film is so large that it is kept less often."""
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(LATE, patience=1e9, **why)
    assert not path.exists()
    made.interrupted(LATE, **why)
    before = path.read_bytes()
    # What goes on is kept, however soon it is interrupted again.
    made.interrupted(LATE + 3, patience=1e9, resumes=True, **why)
    assert path.read_bytes() != before
    assert_same(made.taken_up(), whole)


def test_where_memory_is_short_nothing_is_copied(monkeypatch, path):
    from engine.scene import limits

    made = renderer(monkeypatch, path)
    monkeypatch.setattr(limits, "usable_memory", lambda: 0)
    monkeypatch.setattr(limits, "swap_memory", lambda: 1 << 50)
    made.taken_up(keeps=True)
    assert not path.exists() and made.notices[0].problem == "there is no memory for a copy of the film"


@pytest.mark.skipif(os.name != "posix", reason="locks")
def test_a_file_that_another_render_has_is_left_to_it(monkeypatch, path):
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(LATE)
    before, other = path.read_bytes(), FileHold()
    assert other.take(path)
    # With and without having looked for a file to go on from.
    for resumes in (True, False):
        assert_same(made.taken_up(resumes=resumes, interval=0.0, keeps=True), whole)
        (notice,) = made.notices
        assert "is of another process" in notice.problem and notice.fallback == "this render is not kept"
    with pytest.raises(CheckpointRefused, match="is of another process"):
        made.taken_up(insists=True)
    assert path.read_bytes() == before
    other.release()
    assert_same(made.taken_up(), whole)
    assert made.resumed > 0 and made.notices == []


def test_a_time_limit_counts_what_was_before(monkeypatch, path):
    made = renderer(monkeypatch, path, time_limit=1e6)
    made.interrupted(LATE)
    before = load_checkpoint(path).state.seconds
    again = made.interrupted(LATE, resumes=True)
    assert load_checkpoint(path).state.seconds == pytest.approx(before + again.report.render_seconds, abs=0.5)
    result = made.taken_up()
    assert (result.passes["Sample Count"] == 40).all()
    np.testing.assert_allclose(result.passes["Combined"], made.whole().passes["Combined"], rtol=1e-5)
    # The time is up.
    made.interrupted(LATE)
    made.settings = replace(made.settings, time_limit=1e-6)
    result = made.taken_up()
    assert result.report.ended_by == "TIME_LIMIT" and result.passes["Sample Count"].max() < 40


def test_a_finished_film_gets_more_samples(monkeypatch, path):
    made = renderer(monkeypatch, path, samples=30)
    made.taken_up(keeps=True)
    more = replace(made.settings, samples=40)
    made.settings = more
    film = path.rename(path.with_suffix(".ngfilm"))
    interrupted = made.interrupted(2, film=film)
    assert interrupted.report.cancelled and made.resumed == 30
    added = made.taken_up(film=film)
    assert made.resumed > 30 and (added.passes["Sample Count"] == 40).all()
    np.testing.assert_allclose(added.passes["Combined"], made.whole().passes["Combined"], rtol=1e-5)


def test_pixels_that_were_good_enough_are_judged_anew_where_samples_are_added(monkeypatch, path):
    made = renderer(monkeypatch, path, **NOISE)
    before = made.taken_up(keeps=True).passes["Sample Count"]
    made.settings = replace(made.settings, adaptive_threshold=0.005, samples=128)
    film = path.rename(path.with_suffix(".ngfilm"))
    added = made.taken_up(film=film).passes["Sample Count"]
    assert (added >= before).all() and added.max() > before.max()


@pytest.mark.parametrize(
    ("other", "problem"),
    [
        ({"strength": 3.0}, "is of another scene"),
        ({"max_bounces": 3}, "was made by other settings (max_bounces)"),
        ({"use_adaptive_sampling": True}, "was made by other settings (use_adaptive_sampling)"),
        ({"use_denoising": True}, "was made for other passes"),
        ({}, "was made by another version"),
    ],
)
def test_what_does_not_fit_begins_anew_or_is_refused(monkeypatch, path, other, problem):
    renderer(monkeypatch, path).interrupted(LATE)
    if not other:
        monkeypatch.setattr(checkpoint, "source_version", lambda: "later")
    made = renderer(monkeypatch, path, **other)
    with pytest.raises(CheckpointRefused, match=re.escape(str(path))) as refused:
        made.taken_up(insists=True)
    assert problem in str(refused.value)
    result = made.taken_up()
    (notice,) = made.notices
    assert problem in notice.problem and notice.fallback == "the frame begins anew" and made.resumed == 0
    assert_same(result, made.whole())


def _cut(data):
    return data[: len(data) // 2]


def _flip(data):
    place = data.index(b"arrays/film.radiance") + 1000
    return data[:place] + bytes([data[place] ^ 1]) + data[place + 1 :]


@pytest.mark.parametrize("damage", [_cut, _flip, lambda data: b"", lambda data: b"no checkpoint" * 100])
def test_a_damaged_file_is_named_and_the_frame_begins_anew(monkeypatch, path, damage):
    made = renderer(monkeypatch, path)
    made.interrupted(LATE)
    path.write_bytes(damage(path.read_bytes()))
    assert_same(made.taken_up(), made.whole())
    (notice,) = made.notices
    assert str(path) in notice.problem and "is damaged" in notice.problem


def test_numbers_that_no_render_has_are_refused(monkeypatch, path):
    renderer(monkeypatch, path).interrupted(LATE)
    with zipfile.ZipFile(path) as archive:
        entries = {item.filename: archive.read(item) for item in archive.infolist()}
    name = "neuralguide-checkpoint.json"
    entries[name] = entries[name].replace(b'"path_count": ', b'"path_count": -')
    with zipfile.ZipFile(path, "w") as archive:
        for entry, data in entries.items():
            archive.writestr(entry, data)
    with pytest.raises(CheckpointError, match="negative"):
        load_checkpoint(path)


def test_a_full_disk_costs_no_picture(monkeypatch, path):
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(5)
    before = path.read_bytes()

    def is_full(_descriptor):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(os, "fsync", is_full)
    assert_same(made.taken_up(keeps=True), whole)
    assert f"{path} cannot be written (No space left on device)" in made.notices[0].problem
    assert path.read_bytes() == before and [item.name for item in path.parent.iterdir()] == [path.name]


def test_a_read_only_disk_costs_no_picture(monkeypatch, path):
    """It goes on from what is there, and says once that no more is kept."""
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(5)
    before = path.read_bytes()
    with monkeypatch.context() as patch:
        freeze(patch, path.parent)
        assert_same(made.taken_up(keeps=True), whole)
    assert made.resumed > 0
    assert [notice.problem for notice in made.notices] == [f"{path} cannot be written (Read-only file system)"]
    assert path.read_bytes() == before and [item.name for item in path.parent.iterdir()] == [path.name]


def test_films_of_other_seeds_make_one_picture(monkeypatch, path):
    """Its sums are theirs, and so is its mean by their numbers of samples."""
    parts = []
    for seed, samples in ((1, 8), (2, 24)):
        made = renderer(monkeypatch, path.with_name(f"{seed}"), seed=seed, samples=samples)
        parts.append(made.taken_up(keeps=True))
    merged = tuple(path.with_name(f"{seed}") for seed in (1, 2))
    made = renderer(monkeypatch, path)
    result = made.taken_up(merged=merged)
    assert (result.passes["Sample Count"] == 32).all() and result.report.path_count == 0
    mean = sum(part.passes["Combined"] * weight for part, weight in zip(parts, (0.25, 0.75), strict=True))
    np.testing.assert_allclose(result.passes["Combined"], mean, rtol=1e-5)
    np.testing.assert_array_equal(result.passes["Depth"], parts[0].passes["Depth"])
    matte = result.passes["CryptoObject00"]
    assert (matte.max(axis=2) > 0.0).any() and matte[..., 1].max() == pytest.approx(1.0)
    for films, problem in (
        ((merged[0], merged[0]), "has the same samples as"),
        ((merged[0], path), "there is no film"),
    ):
        with pytest.raises(CheckpointRefused, match=problem):
            made.taken_up(merged=films)
    other = renderer(monkeypatch, path, max_bounces=3)
    with pytest.raises(CheckpointRefused, match=r"other settings \(max_bounces\)"):
        other.taken_up(merged=merged)


def test_films_of_strata_add_up():
    rng = np.random.default_rng(5)
    films = [StrataFilm(3, 2, 4), StrataFilm(3, 2, 4)]
    for film in films:
        for stratum in range(4):
            tile = allocate_tile(6, 3)
            for name in ("radiance", "square", "alpha"):
                getattr(tile, name)[:] = rng.random(getattr(tile, name).shape)
            tile.count[:] = 1
            film.merge_stratum(np.arange(6), tile, 1.0, stratum)
    wanted = sum(film.sums.radiance for film in films)
    add_film(films[0], films[1])
    np.testing.assert_allclose(films[0].sums.radiance, wanted, rtol=1e-5)
    assert (films[0].sums.count == 8).all() and (films[0].by_stratum.sums.count == 2).all()


def test_nobody_finds_a_checkpoint_before_there_is_one(monkeypatch, path):
    made = renderer(monkeypatch, path)
    assert_same(made.taken_up(), made.whole())
    assert not path.exists() and made.notices == []
    with pytest.raises(CheckpointRefused, match="there is no"):
        made.taken_up(film=path)
