# SPDX-License-Identifier: GPL-3.0-or-later
"""Renders that are interrupted and taken up: the same bits, or a sentence that says why the frame begins anew."""

import errno
import os
import re
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from engine.render import checkpoint
from engine.render.checkpoint_file import CheckpointError, load_checkpoint
from engine.render.checkpointing import CheckpointRefused
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


NOISE = {"use_adaptive_sampling": True, "adaptive_threshold": 0.05, "adaptive_min_samples": 4, "samples": 64}


@pytest.mark.parametrize("settings", [{}, NOISE], ids=["plain", "noise threshold"])
def test_a_render_goes_on_to_the_same_bits(monkeypatch, path, settings):
    """Interrupted twice, at the beginning and later."""
    made = renderer(monkeypatch, path, **settings)
    whole = made.whole()
    if settings:
        counts = whole.passes["Sample Count"]
        assert counts.min() < counts.max(), "the threshold is to drop some pixels"
    first = made.interrupted(5)
    assert first.report.cancelled and load_checkpoint(path).state.path_count == first.report.path_count
    second = made.interrupted(LATE, resumes=True)
    assert second.report.cancelled and made.resumed > 0
    assert_same(made.taken_up(), whole)
    assert made.notices == []


def test_the_film_is_kept_while_it_is_rendered(monkeypatch, path):
    """What a process leaves that is killed."""
    made = renderer(monkeypatch, path)
    whole = made.whole()
    made.interrupted(LATE, interval=0.0)
    assert not list(path.parent.glob("*.part"))
    assert_same(made.taken_up(interval=0.0), whole)


def test_a_time_limit_counts_what_was_before(monkeypatch, path):
    made = renderer(monkeypatch, path, time_limit=1e6)
    made.interrupted(LATE)
    with_time = load_checkpoint(path)
    assert with_time.state.seconds > 0.0
    result = made.taken_up()
    assert result.report.render_seconds >= with_time.state.seconds
    assert (result.passes["Sample Count"] == 40).all()
    np.testing.assert_allclose(result.passes["Combined"], made.whole().passes["Combined"], rtol=1e-5)


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


def test_nobody_finds_a_checkpoint_before_there_is_one(monkeypatch, path):
    made = renderer(monkeypatch, path)
    assert_same(made.taken_up(), made.whole())
    assert not path.exists() and made.notices == []
    with pytest.raises(CheckpointRefused, match="there is no"):
        made.taken_up(film=path)
