# SPDX-License-Identifier: GPL-3.0-or-later
"""How rivals look: one colour, marker and line each, the same in every chart and on the page.

Colours are Okabe and Ito's (2008), which the colour-blind tell apart, two of them made lighter or darker so that they
stand out from both a light and a dark page; where they repeat, markers and lines differ.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass

_GREY, _ORANGE, _BLUE, _RED = "#8a8a8a", "#e69f00", "#2f8fd6", "#d55e00"
_PINK, _GREEN, _SKY, _OLIVE = "#cc79a7", "#009e73", "#56b4e9", "#b3a100"


@dataclass(frozen=True)
class Look:
    """matplotlib's names of a colour, a marker and a line."""

    colour: str
    marker: str
    line: str = "-"


LOOKS = {
    "cycles": Look(_GREY, "o"),
    "cycles-guided": Look(_ORANGE, "s"),
    "cycles-fast-gi": Look(_SKY, "x", "--"),
    "better of Cycles": Look("#7d6b3d", "+"),
    "OFF": Look(_BLUE, "^"),
    "VMM": Look(_RED, "D"),
    "VMM_RIS": Look(_PINK, "v"),
    "TABLE_RIS": Look(_GREEN, "P"),
    "NEURAL_RIS": Look(_SKY, "X"),
    "AUTO": Look(_OLIVE, "*"),
    "AUTO-AUTO": Look(_RED, "4"),
    "SDTREE": Look(_PINK, "<", "--"),
    "SDTREE_VARIANCE": Look(_SKY, ">", "--"),
    "NPM": Look(_GREEN, "p", "--"),
    "NPM_PRODUCT": Look(_ORANGE, "h", "--"),
    "NASG": Look(_BLUE, "d", "--"),
    "FLOW": Look(_GREY, "H", "--"),
    "NASG-RADIANCE": Look(_RED, "1", ":"),
    "NASG-COSINE": Look(_GREEN, "2", ":"),
    "NASG-SG": Look(_PINK, "3", ":"),
}
_OTHERS = [Look(colour, "x", "-.") for colour in (_SKY, _OLIVE, _PINK, _ORANGE, _GREEN, _BLUE, _RED, _GREY)]

#: Marks in text, for matplotlib's markers.
GLYPHS = {
    "o": "●", "s": "■", "^": "▲", "D": "◆", "v": "▼", "P": "✚", "X": "✖", "*": "★", "<": "◀", ">": "▶", "p": "⬟",
    "h": "⬢", "d": "⬧", "H": "⬣", "1": "⅄", "2": "Y", "3": "≺", "4": "≻", "x": "×", "+": "+",
}  # fmt: skip

#: Kinds of work (`figures.TIME_KINDS`): colours (Tol's muted ones) that no rival has, each with a hatch of its own.
KINDS = {
    "tracing": ("#44aa99", ""),
    "shading": ("#88ccee", "//"),
    "inference": ("#ddcc77", ".."),
    "fitting": ("#cc6677", "\\\\"),
    "training": ("#aa4499", "xx"),
    "waiting": ("#9aa0a8", "--"),
    "rendering": ("#6f7680", ""),
}


def look(rival: str) -> Look:
    """The look of a rival by its label; unknown ones get one by their name, the same every time."""
    return LOOKS.get(rival) or _OTHERS[zlib.crc32(rival.encode()) % len(_OTHERS)]


@dataclass(frozen=True)
class Theme:
    """Colours of a chart's ground, text and grid. `suffix` goes into the names of its files."""

    name: str
    suffix: str
    ground: str
    text: str
    grid: str


LIGHT = Theme("light", "", "#ffffff", "#1c1c1c", "#d9d9d9")
DARK = Theme("dark", "-dark", "#1b1d21", "#e6e6e6", "#3a3d44")
THEMES = (LIGHT, DARK)
