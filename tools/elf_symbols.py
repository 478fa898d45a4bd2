# SPDX-License-Identifier: GPL-3.0-or-later
"""Names that an object file defines and asks for, read from its table of symbols (ELF, 64 bits, little-endian)."""

from __future__ import annotations

import struct
from dataclasses import dataclass

#: Type of the section that holds symbols.
_SYMBOL_TABLE = 2
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
#: Binding of symbols that other files do not see.
_LOCAL = 0


@dataclass(frozen=True)
class Symbols:
    """Names in an object file."""

    defined: frozenset[str]
    undefined: frozenset[str]


def read_symbols(data: bytes) -> Symbols:
    """Symbols of an object file that others can see.

    Raises
    ------
    ValueError
        If it is no such file.
    """
    if data[:6] != b"\x7fELF\x02\x01":
        raise ValueError("not an ELF file of 64 bits")
    (offset,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    sections = [_SECTION.unpack_from(data, offset + size * index) for index in range(count)]
    defined, undefined = set(), set()
    for section in sections:
        _, kind, _, _, start, length, link, *_ = section
        if kind != _SYMBOL_TABLE:
            continue
        names = sections[link][4]
        for position in range(start, start + length, _SYMBOL.size):
            name_offset, info, _, index, _, _ = _SYMBOL.unpack_from(data, position)
            name = data[names + name_offset : data.index(b"\0", names + name_offset)].decode()
            if name and info >> 4 != _LOCAL:
                (defined if index else undefined).add(name)
    return Symbols(frozenset(defined), frozenset(undefined))
