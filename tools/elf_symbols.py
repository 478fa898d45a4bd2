# SPDX-License-Identifier: GPL-3.0-or-later
"""Names in an object file: which it defines and asks for, and making some its own (ELF, 64 bits, little-endian)."""

from __future__ import annotations

import struct
from collections.abc import Iterator
from dataclasses import dataclass

#: Type of the section that holds symbols.
_SYMBOL_TABLE = 2
_SECTION = struct.Struct("<IIQQQQIIQQ")
_SYMBOL = struct.Struct("<IBBHQQ")
#: Where a section's header has its offset in the file, followed by its size.
_SECTION_OFFSET = 24
#: Bindings of symbols: what other files do not see, and what they may define as well.
_LOCAL, _WEAK = 0, 2


@dataclass(frozen=True)
class Symbols:
    """Names in an object file."""

    defined: frozenset[str]
    undefined: frozenset[str]


@dataclass(frozen=True)
class _Symbol:
    name: str
    position: int  # in the file
    binding: int
    is_defined: bool


def _sections(data: bytes) -> tuple[int, int, list[tuple[int, ...]]]:
    """Where headers of sections begin, the size of one, and what they say."""
    if data[:6] != b"\x7fELF\x02\x01":
        raise ValueError("not an ELF file of 64 bits")
    (offset,) = struct.unpack_from("<Q", data, 40)
    size, count = struct.unpack_from("<HH", data, 58)
    return offset, size, [_SECTION.unpack_from(data, offset + size * index) for index in range(count)]


def _symbols(data: bytes) -> Iterator[tuple[_Symbol, int]]:
    """Symbols that other files see, each with the section of its name."""
    sections = _sections(data)[2]
    for _, kind, _, _, start, length, link, *_ in sections:
        if kind != _SYMBOL_TABLE:
            continue
        names = sections[link][4]
        for position in range(start, start + length, _SYMBOL.size):
            name_offset, info, _, index, _, _ = _SYMBOL.unpack_from(data, position)
            name = data[names + name_offset : data.index(b"\0", names + name_offset)].decode()
            if name and info >> 4 != _LOCAL:
                yield _Symbol(name, position, info >> 4, bool(index)), link


def read_symbols(data: bytes) -> Symbols:
    """Symbols of an object file that others can see.

    Raises
    ------
    ValueError
        If it is no such file.
    """
    symbols = [symbol for symbol, _ in _symbols(data)]
    return Symbols(
        frozenset(symbol.name for symbol in symbols if symbol.is_defined),
        frozenset(symbol.name for symbol in symbols if not symbol.is_defined),
    )


def with_own_functions(data: bytes, owner: str) -> bytes:
    """An object file in which names that other files may define as well begin with `owner`.

    A linker takes the first definition of such a name for all files. Each kernel is to keep the helpers that were
    compiled with it: numba numbers functions by process, so the same name may mean another one elsewhere.

    Raises
    ------
    ValueError
        If it is no such file.
    """
    shared = [(symbol, link) for symbol, link in _symbols(data) if symbol.binding == _WEAK and symbol.is_defined]
    if not shared:
        return data
    offset, size, sections = _sections(data)
    (link,) = {link for _, link in shared}
    start, length = sections[link][4:6]
    changed, names = bytearray(data), bytearray(data[start : start + length])
    for index, (symbol, _) in enumerate(shared):
        struct.pack_into("<I", changed, symbol.position, len(names))
        names += f"{owner}_{index}".encode() + b"\0"
    struct.pack_into("<QQ", changed, offset + size * link + _SECTION_OFFSET, len(changed), len(names))
    return bytes(changed + names)
