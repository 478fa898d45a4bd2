# SPDX-License-Identifier: GPL-3.0-or-later
"""Numbers and strings as Blender's nodes write them (5.3): Format String, and whole numbers by any base.

A format is a text with values in braces, `{}`, `{0}` or `{name}`, and behind a colon how to write them: as in Python,
or as in templates of paths, where `#` stands for a digit.
"""

from __future__ import annotations

import re
from typing import NamedTuple

import numpy as np

_DIGITS = "0123456789abcdefghijklmnopqrstuvwxyz"
_LARGEST = 2**31 - 1
_SIZE = r"(?:\d+|(\{.*\}))?"
_PRECISION = r"(?:\.(?:\d+|(\{.*\})))?"
#: What may stand behind a colon, by the type of a socket: width and precision may be named in braces.
_PATTERNS = {
    "VALUE": re.compile(rf"(?:[^{{}}]?[<>^])?[+\- ]?0?{_SIZE}{_PRECISION}([aAeEfFgG]?)"),
    "INT": re.compile(rf"(?:[^{{}}]?[<>^])?[+\- ]?0?{_SIZE}()([bBcdoxX]?)"),
    "STRING": re.compile(rf"(?:[^{{}}]?[<>^])?{_SIZE}{_PRECISION}([s?]?)"),
}


class Item(NamedTuple):
    """A value that a format may write; its kind is the type of its socket."""

    name: str
    kind: str
    value: float | int | str


class _Failed(Exception):
    """Blender cannot read the format, and gives an empty string."""


class _Unsupported(Exception):
    """The format asks for what is not known here."""


def by_base(value: int, base: int, padding: int) -> str:
    """A whole number by a base of 2 to 36, with zeros in front; '' for other bases."""
    if not 2 <= base <= len(_DIGITS):
        return ""
    digits = ""
    rest = abs(value)
    while rest or not digits:
        rest, digit = divmod(rest, base)
        digits = _DIGITS[digit] + digits
    sign = "-" if value < 0 else ""
    return sign + digits.zfill(max(padding, 0) - len(sign))


def read_by_base(text: str, base: int) -> tuple[int, int]:
    """The whole number that a text begins with, and of how many characters it is; zeros if there is none."""
    if not 2 <= base <= len(_DIGITS):
        return 0, 0
    known = _DIGITS[:base]
    end = start = 1 if text.startswith("-") else 0
    while end < len(text) and text[end].lower() in known:
        end += 1
    if end == start:
        return 0, 0
    value = int(text[:end], base)
    # One that no integer holds is none.
    return (value, end) if -_LARGEST - 1 <= value <= _LARGEST else (0, 0)


def trimmed(text: str, characters: str, *, at_start: bool, at_end: bool) -> str:
    """A text without those characters at its ends."""
    text = text.lstrip(characters) if at_start else text
    return text.rstrip(characters) if at_end else text


def format_string(text: str, items: list[Item]) -> str | None:
    """What a Format String node makes of a format; None if that is not known."""
    try:
        return _formatted(text, _Lookup(items))
    except _Failed:
        return ""
    except _Unsupported:
        return None


class _Lookup:
    """Finds values by nothing (the next), by number or by name; by nothing only before one was named."""

    def __init__(self, items: list[Item]) -> None:
        self._items = items
        self._next: int | None = 0

    def find(self, name: str) -> Item:
        if not name:
            if self._next is None or self._next == len(self._items):
                raise _Failed
            self._next += 1
            return self._items[self._next - 1]
        self._next = None
        if name[0].isdigit():
            if not name.isdigit() or int(name) >= len(self._items):
                raise _Failed
            return self._items[int(name)]
        found = next((item for item in self._items if item.name == name), None)
        if found is None:
            raise _Failed
        return found

    def whole(self, outer: str) -> str:
        """The number that stands for a width or precision in braces."""
        item = self.find(outer[1:-1])
        if item.kind != "INT":
            raise _Failed
        return str(max(int(item.value), 0))


def _formatted(text: str, lookup: _Lookup) -> str:
    result, i = "", 0
    while i < len(text):
        if text[i] not in "{}":
            result += text[i]
            i += 1
        elif text[i : i + 2] == 2 * text[i]:
            result += text[i]
            i += 2
        else:
            end = _end_of_braces(text, i)
            name, _, how = text[i + 1 : end - 1].partition(":")
            result += _written(lookup.find(name), how, lookup)
            i = end
    return result


def _end_of_braces(text: str, start: int) -> int:
    depth = 1
    for i in range(start + 1, len(text)):
        depth += (text[i] == "{") - (text[i] == "}")
        if depth == 0:
            return i + 1
    raise _Failed


def _written(item: Item, how: str, lookup: _Lookup) -> str:
    if item.kind not in _PATTERNS:
        raise _Failed
    value = np.float32(item.value).item() if item.kind == "VALUE" else item.value
    if not how:
        return _shortest(value) if isinstance(value, float) else str(value)
    if "#" in how:
        return _by_template(value, how)
    match = _PATTERNS[item.kind].fullmatch(how)
    if match is None:
        raise _Failed
    width, precision, letter = match.groups()
    for outer in (width, precision):
        if outer:
            how = how.replace(outer, lookup.whole(outer), 1)
    if letter and letter in "aA?":
        raise _Unsupported
    if isinstance(value, float) and not letter:
        # Python writes one digit more.
        how += "g" if "." in how else f".{_decimals(value)}f"
    try:
        return format(value, how.replace("B", "b"))
    except ValueError:
        raise _Failed from None


def _decimals(value: float) -> int:
    """How many digits `_shortest` writes behind the point, 0 if they are zero."""
    decimals = _shortest(value).partition(".")[2]
    return 0 if decimals == "0" else len(decimals)


def _shortest(value: float) -> str:
    """The fewest digits that tell a float32 from others, and one behind the point."""
    if value != 0.0 and not 1e-4 <= abs(value) < 1e16:
        raise _Unsupported
    return np.format_float_positional(np.float32(value), trim="0")


def _by_template(value: float | int | str, how: str) -> str:
    """A whole number in at least so many digits."""
    if isinstance(value, str):
        raise _Failed
    if isinstance(value, float) or how.strip("#"):
        raise _Unsupported
    return f"{value:0{len(how)}d}"
