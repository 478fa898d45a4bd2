# SPDX-License-Identifier: GPL-3.0-or-later
"""What files of Windows and macOS say of themselves: names in objects and libraries (COFF and PE; Mach-O; 64 bits)."""

from __future__ import annotations

import struct
from collections.abc import Iterator

if __package__:
    from .elf_symbols import Symbols
else:
    from elf_symbols import Symbols

_AMD64, _ARM64 = 0x8664, 0x0100000C
_MACH_MAGIC = 0xFEEDFACF
_DYLIB = 6
_SYMTAB = 2
_IS_DLL = 0x2000
#: Of a COFF symbol: seen by other files; of one that is nowhere, its size where the linker is to make room.
_EXTERNAL = 2
_COFF_SYMBOL = struct.Struct("<8sIhHBB")
_COFF_SECTION = struct.Struct("<8sIIIIIIHHI")
_NLIST = struct.Struct("<IBBHQ")
#: Bits of a Mach-O symbol's type: of debuggers, the kind, seen by other files.
_STAB, _TYPE, _EXT = 0xE0, 0x0E, 0x01


def _text(data: bytes, at: int) -> str:
    return data[at : data.index(b"\0", at)].decode()


def _coff(data: bytes) -> Iterator[tuple[str, bool]]:
    machine, _, _, table, count = struct.unpack_from("<HHIII", data)
    if machine != _AMD64:
        raise ValueError("not an object for Windows on x86-64")
    names, index = table + _COFF_SYMBOL.size * count, 0
    while index < count:
        raw, value, section, _, storage, more = _COFF_SYMBOL.unpack_from(data, table + _COFF_SYMBOL.size * index)
        index += 1 + more
        if storage == _EXTERNAL:
            is_long = raw[:4] == b"\0\0\0\0"
            name = _text(data, names + struct.unpack_from("<I", raw, 4)[0]) if is_long else raw.rstrip(b"\0").decode()
            yield name, bool(section or value)


def _mach(data: bytes, filetype: int | None = None) -> Iterator[tuple[str, bool]]:
    magic, processor, _, kind, command_count = struct.unpack_from("<IIIII", data)
    if (magic, processor) != (_MACH_MAGIC, _ARM64) or filetype not in (None, kind):
        raise ValueError("not such a file for macOS on ARM")
    at = 32
    for _ in range(command_count):
        command, size = struct.unpack_from("<II", data, at)
        if command == _SYMTAB:
            table, count, names, _ = struct.unpack_from("<IIII", data, at + 8)
            for index in range(count):
                name, bits, section, _, value = _NLIST.unpack_from(data, table + _NLIST.size * index)
                if bits & _EXT and not bits & _STAB:
                    # Names of C have an underscore more.
                    yield _text(data, names + name).removeprefix("_"), bool(bits & _TYPE and (section or value))
        at += size


def _symbols(found: Iterator[tuple[str, bool]]) -> Symbols:
    pairs = list(found)
    defined = frozenset(name for name, is_defined in pairs if is_defined)
    return Symbols(defined, frozenset(name for name, is_defined in pairs if not is_defined) - defined)


def read_object(data: bytes) -> Symbols:
    """Names of an object that other files see.

    Raises
    ------
    ValueError
        If it is for another system.
    """
    is_mach = data[:4] == struct.pack("<I", _MACH_MAGIC)
    return _symbols(_mach(data) if is_mach else _coff(data))


def read_library(data: bytes) -> Symbols:
    """Names that a shared library has, and those that it needs from others.

    Raises
    ------
    ValueError
        If it is none, or for another system.
    """
    if data[:2] != b"MZ":
        return _symbols(_mach(data, _DYLIB))
    (header,) = struct.unpack_from("<I", data, 0x3C)
    machine, section_count, _, _, _, optional, flags = struct.unpack_from("<HHIIIHH", data, header + 4)
    if data[header : header + 4] != b"PE\0\0" or machine != _AMD64 or not flags & _IS_DLL:
        raise ValueError("not a library for Windows on x86-64")
    first = header + 24
    sections = [_COFF_SECTION.unpack_from(data, first + optional + 40 * index) for index in range(section_count)]

    def place(address: int) -> int:
        for _, size, start, _, offset, *_ in sections:
            if start <= address < start + size:
                return offset + address - start
        raise ValueError("the library is damaged")

    exports, _, imports, _ = struct.unpack_from("<IIII", data, first + 112)
    defined: set[str] = set()
    if exports:
        count, _, names = struct.unpack_from("<III", data, place(exports) + 24)
        listed = struct.unpack_from(f"<{count}I", data, place(names))
        defined = {_text(data, place(address)) for address in listed}
    return Symbols(frozenset(defined), frozenset({"imports"} if imports else ()))
