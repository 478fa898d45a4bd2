# SPDX-License-Identifier: GPL-3.0-or-later
"""The command line as Blender reads it, without Blender."""

from __future__ import annotations

import re

import pytest

from addon.cli_arguments import Action, CommandLineError, parse_arguments, parse_frame, parse_frames
from addon.declared_settings import parse_setting


def test_actions_keep_the_order_given() -> None:
    line = "-b scene.blend -E NEURALGUIDE -o //render_#### -f 1 -o //other_ -F PNG -x 0 -s 2 -e 9 -j 3 -S Two -a"
    assert [(item.name, item.value) for item in parse_arguments(line.split())] == [
        ("background", ""),
        ("load", "scene.blend"),
        ("engine", "NEURALGUIDE"),
        ("render-output", "//render_####"),
        ("render-frame", "1"),
        ("render-output", "//other_"),
        ("render-format", "PNG"),
        ("use-extension", "0"),
        ("frame-start", "2"),
        ("frame-end", "9"),
        ("frame-jump", "3"),
        ("scene", "Two"),
        ("render-anim", ""),
    ]


def test_long_options_are_the_same() -> None:
    line = "--background --engine CYCLES --render-output x --threads 2 --render-frame 3 --render-anim"
    assert [item.name for item in parse_arguments(line.split())] == [
        "threads",  # wherever it stands, as in Blender
        "background",
        "engine",
        "render-output",
        "render-frame",
        "render-anim",
    ]


def test_values_may_look_like_options() -> None:
    assert parse_arguments(["-f", "-1", "-s", "-2", "-o", "-strange"]) == [
        Action("render-frame", "-1"),
        Action("frame-start", "-2"),
        Action("render-output", "-strange"),
    ]


def test_two_dashes_end_the_options() -> None:
    assert parse_arguments(["a.blend", "--", "--mine", "-f"]) == [Action("load", "a.blend")]


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--frobnicate", "unknown option '--frobnicate'"),
        ("-z", "unknown option '-z'"),
        ("-f", "-f needs a value"),
        ("-E", "-E needs a value"),
        ("-f one", "-f one: 'one' is no whole number"),
        ("-f 1,,2", "-f 1,,2: '' is no whole number"),
        ("-f 1...3", "is no whole number"),
        ("-s 1.5", "-s 1.5:"),
        ("-j 0", "-j 0:"),
        ("-j -1", "-j -1:"),
        ("-t -1", "-t -1:"),
        ("-x yes", "-x yes: choose 0 or 1"),
        ("-f ²", "is no whole number"),
        ("-f 5..1", "-f 5..1: frame 1 is before frame 5"),
        ("-f 1,9..3", "frame 3 is before frame 9"),
        ("-f 1..", "'' is no whole number"),
        ("-f ..3", "'' is no whole number"),
        ("-f 1,", "'' is no whole number"),
        ("-f 1-3", "is no whole number"),
        ("-f +", "'' is no whole number"),
    ],
)
def test_nonsense_is_refused_by_name(line: str, message: str) -> None:
    with pytest.raises(CommandLineError) as caught:
        parse_arguments(line.split())
    assert message in str(caught.value)


@pytest.mark.parametrize(
    ("text", "frames"),
    [
        ("7", [7]),
        ("1,3,5", [1, 3, 5]),
        ("5,1,3", [5, 1, 3]),
        ("1..4", [1, 2, 3, 4]),
        ("1..3,8,+1,-1", [1, 2, 3, 8, 11, 19]),
        ("+0..-0", list(range(10, 21))),
        ("2..2", [2]),
        ("0", [0]),
    ],
)
def test_frames(text: str, frames: list[int]) -> None:
    assert parse_frames(text, 10, 20) == frames


@pytest.mark.parametrize("text", ["4..2", "1,4..2", "+0..9", "+1..-10", "30..-0"])
def test_a_range_that_ends_before_it_begins_is_refused(text: str) -> None:
    """By the file's frames 10 to 20, as Blender does; else the command would succeed, with nothing rendered."""
    with pytest.raises(CommandLineError, match=r"frame \d+ is before frame \d+"):
        parse_frames(text, 10, 20)


def test_ranges_that_depend_on_the_file_are_left_to_it() -> None:
    assert parse_arguments(["-f", "+0..-0"]) == [Action("render-frame", "+0..-0")]
    assert parse_arguments(["-f", "5..-0"]) == [Action("render-frame", "5..-0")]


def test_frames_are_clamped() -> None:
    assert parse_frame("-30", 10, 20) == 0
    assert parse_frame("+1048574", 10, 20) == 1048574


def test_settings_are_parsed_by_their_declarations() -> None:
    for text, expected in {
        "guiding_method=OFF": ("guiding_method", "OFF"),
        "strata=8": ("strata", 8),
        "experiment.strata = 8": ("strata", 8),
        "time_limit=2.5": ("time_limit", 2.5),
        "deterministic=on": ("deterministic", True),
        "experiment.use_nee=0": ("use_nee", False),
        "film_exposure=2": ("film_exposure", 2.0),
    }.items():
        assert parse_setting(text) == expected
    assert parse_arguments(["--set", "strata=8"]) == [Action("set", "strata=8")]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("guiding_methode=OFF", "no setting 'guiding_methode'; there are guiding_method"),
        ("experiment.samples=8", "no setting 'experiment.samples'; there are"),
        ("guiding_method=ON", "choose one of AUTO, OFF,"),
        ("strata", "write strata=VALUE"),
        ("strata=65", "strata is 65: choose 0 to 64"),
        ("strata=8.5", "choose a whole number, 0 to 64"),
        ("time_limit=-1", "choose 0 or more"),
        ("time_limit=nan", "choose 0 or more"),
        ("time_limit=inf", "choose a finite number, 0 or more"),
        ("film_exposure=nan", "choose 0 or more"),
        ("film_exposure=inf", "choose a finite number, 0 or more"),
        ("time_limit=long", "choose a number, 0 or more"),
        ("deterministic=maybe", "choose on or off"),
    ],
)
def test_settings_that_make_no_sense_are_refused(text: str, message: str) -> None:
    with pytest.raises(CommandLineError, match=f"--set {re.escape(text)}: .*{re.escape(message)}"):
        parse_arguments(["--set", text])


@pytest.mark.parametrize("address", ["local:4", "tcp://render-01:8786", "tls://[::1]:8786"])
def test_addresses_of_clusters(address: str) -> None:
    assert parse_arguments(["--cluster", address]) == [Action("cluster", address)]


@pytest.mark.parametrize("address", ["local", "local:0", "local:many", "tcp://render-01", "tcp:render-01:1", "http://a:1"])
def test_what_is_no_address_of_a_cluster(address: str) -> None:
    with pytest.raises(CommandLineError, match=r"--cluster"):
        parse_arguments(["--cluster", address])


@pytest.mark.parametrize(
    ("line", "message"),
    [
        ("--checkpoint -1", "'-1' is no number of seconds from 0 to 86400"),
        ("--checkpoint nan", "'nan' is no number of seconds"),
        ("--add-samples 0", "'0' is no whole number from 1"),
        ("--merge a.exr --keep-film", "--merge makes one picture and no film: leave --keep-film out"),
        ("--add-samples 8 --merge a.exr", "leave --add-samples out"),
    ],
)
def test_checkpoints_that_make_no_sense_are_refused(line: str, message: str) -> None:
    with pytest.raises(CommandLineError, match=re.escape(message)):
        parse_arguments(line.split())
