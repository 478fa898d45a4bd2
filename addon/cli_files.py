# SPDX-License-Identifier: GPL-3.0-or-later
"""Files that the command line has made one after the other: it names each, and returns what went wrong."""

from __future__ import annotations

from collections.abc import Callable

from . import console
from .exr_layers import LayersError
from .frame_by_frame import FileMaker


def say_files(maker: FileMaker, doing: str, should_stop: Callable[[], bool]) -> str:
    """Have files made until `should_stop()`; returns what went wrong while `doing` it, '' where nothing did."""
    try:
        for written in maker:
            console.say(f"Saved: '{written}'")
            if should_stop():
                return ""
    except (LayersError, OSError) as error:
        console.complain(f"{doing}: {error}")
        return str(error)
    for warning in maker.warnings:
        console.say(f"NeuralGuide: {warning}")
    return ""
