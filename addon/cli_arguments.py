# SPDX-License-Identifier: GPL-3.0-or-later
"""Blender's command line, read without Blender: arguments become actions, in the order in which they stand.

Order matters as it does in Blender: `-o` after `-f` comes too late for that frame, and a file loaded later brings its
own settings. Only `-t`, like there, counts wherever it stands.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from .declared_settings import parse_setting

#: Blender's MAXFRAME; frames are clamped to 0..MAX_FRAME as there.
MAX_FRAME = 1048574

USAGE = """\
usage: python -m addon [file.blend] [options ...]

Renders on top of the bpy module with Blender's own options and --set. They act one after the other, in the order
given: put the file first, settings next, -f or -a last. Exits with 1 when a frame failed, with 2 when the command line
makes no sense.

  -b, --background             Accepted and ignored: there is no window
  -E, --engine <engine>        Render engine: NEURALGUIDE, CYCLES, ... ('help' lists them)
  -S, --scene <name>           Scene to render
  -o, --render-output <path>   Output path; '//' is the .blend's folder, '####' the frame number
  -F, --render-format <format> PNG, JPEG, TIFF, OPEN_EXR, OPEN_EXR_MULTILAYER, ...
  -x, --use-extension <0|1>    Whether to add the format's extension to the path
  -s, --frame-start <frame>    First frame of the animation; +N and -N are relative
  -e, --frame-end <frame>      Last frame of the animation; +N and -N are relative
  -j, --frame-jump <frames>    Frames to step forward after each one
  -t, --threads <threads>      Threads to render with, 0 = all
  --set <name>=<value>         A setting of NeuralGuide, as in docs/settings.md: guiding_method=OFF, experiment.strata=8
  --field <file>               Start from what was learned and saved in this file; with --set save_field=on before it
                               the file is made, and what is learned is saved to it
  --cluster <address>          Have other processes render: local:4 for four on this machine, tcp://HOST:PORT or
                               tls://HOST:PORT for the workers of a scheduler of Dask (docs/farm.md)
  --checkpoint <seconds>       How often a frame is kept next to its file while it is rendered, for --resume; 0 = never.
                               Else once a minute, large ones less often, where the scene keeps unfinished frames
  --resume                     Go on with a frame where it was kept last. Leave frames alone whose files are there and
                               whole, and make an empty file for each frame when it begins: Blender's Overwrite off,
                               and Placeholders on
  --resume-or-fail             As --resume, but a frame fails whose checkpoint is of another scene, version or setting;
                               by --resume it begins anew
  --keep-film                  Keep the film of a finished frame next to its file, for --add-samples
  --add-samples <samples>      Render finished frames on, by so many samples a pixel: those whose film was kept
  --merge <picture>            Make the frame of the films that were kept next to this picture (part_1_####.exr) and to
                               those of other --merge, each rendered by a seed of its own
  -f, --render-frame <frames>  Render frames and save them: 7, 1,3,5, 1..10, +N from the start, -N from the end
  -a, --render-anim            Render from the first frame to the last
  --denoise-sequence <file>    Denoise all rendered frames of which this OpenEXR MultiLayer file is one, over time, into
                               the folder "denoised" beside them
  --mix-sequence <file>        Mix the light groups of all rendered frames of which this OpenEXR MultiLayer file is one,
                               by the scene's light mix at each frame, into the folder "mixed" beside them
  -h, --help                   Show this and exit
  -v, --version                Show versions and exit
  --report                     Show what a report of a bug needs, and exit: versions, processor, the end of the log
  --                           Leave what follows to scripts
"""


class CommandLineError(ValueError):
    """The command line makes no sense; the message says why."""


@dataclass(frozen=True)
class Action:
    """One thing to do; `name` is the long option without dashes, or 'load'."""

    name: str
    value: str = ""


#: Every spelling: (long name, does a value follow).
_OPTIONS = {
    "-b": ("background", False),
    "-E": ("engine", True),
    "-S": ("scene", True),
    "-o": ("render-output", True),
    "-F": ("render-format", True),
    "-x": ("use-extension", True),
    "-s": ("frame-start", True),
    "-e": ("frame-end", True),
    "-j": ("frame-jump", True),
    "-t": ("threads", True),
    "-f": ("render-frame", True),
    "-a": ("render-anim", False),
    "-h": ("help", False),
    "-v": ("version", False),
    "--report": ("report", False),
}
_OPTIONS |= {f"--{name}": (name, takes_value) for name, takes_value in list(_OPTIONS.values())}
_OPTIONS["--set"] = ("set", True)  # ours; Blender has none of the name
_OPTIONS["--field"] = ("field", True)  # ours as well
_OPTIONS["--cluster"] = ("cluster", True)  # and this
_OPTIONS["--checkpoint"] = ("checkpoint", True)  # and this
_OPTIONS["--resume"] = ("resume", False)  # and this
_OPTIONS["--resume-or-fail"] = ("resume-or-fail", False)  # and this
_OPTIONS["--keep-film"] = ("keep-film", False)  # and this
_OPTIONS["--add-samples"] = ("add-samples", True)  # and this
_OPTIONS["--merge"] = ("merge", True)  # and this
_OPTIONS["--denoise-sequence"] = ("denoise-sequence", True)  # and this
_OPTIONS["--mix-sequence"] = ("mix-sequence", True)  # and this
_MOST_LOCAL_WORKERS = 256
#: A day.
_MOST_SECONDS = 86400.0
#: As `engine.settings.MAX_SAMPLES`.
_MOST_SAMPLES = 1 << 24


def parse_arguments(arguments: Sequence[str]) -> list[Action]:
    """Turn a command line into actions.

    Raises
    ------
    CommandLineError
        For an unknown option, a missing value, or a value that can be seen to be wrong without a file.
    """
    actions: list[Action] = []
    pending = list(arguments)
    while pending:
        argument = pending.pop(0)
        if argument == "--":
            break
        if not argument.startswith("-"):
            actions.append(Action("load", argument))
            continue
        if argument not in _OPTIONS:
            raise CommandLineError(f"unknown option {argument!r}; --help lists what there is")
        name, takes_value = _OPTIONS[argument]
        value = ""
        if takes_value:
            # `-s -1` and `-f -2` are relative frames, not options.
            if not pending:
                raise CommandLineError(f"{argument} needs a value; --help says which")
            value = pending.pop(0)
        _check(argument, name, value)
        actions.append(Action(name, value))
    names = {item.name for item in actions}
    for other in ("add-samples", "keep-film"):
        if {"merge", other} <= names:
            raise CommandLineError(f"--merge makes one picture and no film: leave --{other} out")
    # Blender reads -t before anything else, wherever it stands.
    return [item for item in actions if item.name == "threads"] + [item for item in actions if item.name != "threads"]


def _check(argument: str, name: str, value: str) -> None:
    """Raise for a value that is wrong whatever the file holds."""
    checks: dict[str, Callable[[], object]] = {
        "render-frame": lambda: _check_frames(value),
        "frame-start": lambda: parse_frame(value, 1, 1),
        "frame-end": lambda: parse_frame(value, 1, 1),
        "frame-jump": lambda: _parse_int(value, 1, MAX_FRAME),
        "threads": lambda: _parse_int(value, 0, 1024),
        "set": lambda: parse_setting(value),
        "cluster": lambda: _check_cluster(value),
        "checkpoint": lambda: _check_seconds(value),
        "add-samples": lambda: _parse_int(value, 1, _MOST_SAMPLES),
    }
    try:
        if name in checks:
            checks[name]()
        elif name == "use-extension" and value not in {"0", "1"}:
            raise CommandLineError("choose 0 or 1")
    except ValueError as error:
        raise CommandLineError(f"{argument} {value}: {error}") from None


def _parse_int(text: str, low: int, high: int) -> int:
    if not text.isascii() or not text.isdigit() or not low <= int(text) <= high:
        raise CommandLineError(f"{text!r} is no whole number from {low} to {high}")
    return int(text)


def _check_seconds(text: str) -> None:
    """Raise for what is no interval."""
    try:
        seconds = float(text)
    except ValueError:
        seconds = -1.0
    if not 0.0 <= seconds <= _MOST_SECONDS:
        raise CommandLineError(f"{text!r} is no number of seconds from 0 to {_MOST_SECONDS:g}")


def _check_cluster(text: str) -> None:
    """Raise for what is no address of a cluster."""
    kind, _, rest = text.partition(":")
    if kind == "local":
        _parse_int(rest, 1, _MOST_LOCAL_WORKERS)
        return
    host, _, port = rest.removeprefix("//").rpartition(":")
    if kind not in ("tcp", "tls") or not rest.startswith("//") or not host:
        raise CommandLineError("it is none of local:4, tcp://HOST:PORT and tls://HOST:PORT")
    _parse_int(port, 1, 65535)


def parse_frame(text: str, plus_base: int, minus_base: int) -> int:
    """A frame number: `7`, `+2` counted from `plus_base`, `-2` counted back from `minus_base`; clamped."""
    if text[:1] == "+":
        frame = plus_base + _parse_int(text[1:], 0, MAX_FRAME)
    elif text[:1] == "-":
        frame = minus_base - _parse_int(text[1:], 0, MAX_FRAME)
    else:
        frame = _parse_int(text, 0, MAX_FRAME)
    return min(max(frame, 0), MAX_FRAME)


def parse_frames(text: str, start: int, end: int) -> list[int]:
    """Frames of `-f`: a list like `1,4..6,+0,-1`, in the order given; `+` counts from `start`, `-` back from `end`.

    Raises
    ------
    CommandLineError
        Naming the part that is no frame, or the range that ends before it begins.
    """
    frames: list[int] = []
    for part in text.split(","):
        frames.extend(_parse_range(part, start, end))
    return frames


def _parse_range(text: str, start: int, end: int) -> range:
    first, dots, last = text.partition("..")
    low = parse_frame(first, start, end)
    high = parse_frame(last, start, end) if dots else low
    if high < low:
        raise CommandLineError(f"frame {high} is before frame {low}: write the first frame of a range first")
    return range(low, high + 1)


def _check_frames(text: str) -> None:
    """Raise for what is no list of frames whatever frames the file has."""
    for part in text.split(","):
        first, dots, last = part.partition("..")
        if first[:1] in ("+", "-") or last[:1] in ("+", "-"):
            for frame in (first, last) if dots else (first,):
                parse_frame(frame, 1, 1)
        else:
            _parse_range(part, 1, 1)
