# SPDX-License-Identifier: GPL-3.0-or-later
"""The wire format of protocol buffers, as much of it as ONNX needs: fields of a message to bytes and back.

References
----------
Protocol Buffers, "Encoding" (protobuf.dev/programming-guides/encoding).
"""

from __future__ import annotations

import struct
from collections.abc import Iterator
from typing import NamedTuple

#: Kinds of fields on the wire.
VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5

_FIXED_SIZES = {FIXED64: 8, FIXED32: 4}
_WORD = 1 << 64


class ProtobufError(ValueError):
    """Bytes that are no message."""


class Field(NamedTuple):
    """A field of a message.

    number : int, which field
    kind : int, VARINT, FIXED64, BYTES or FIXED32
    value : int of a VARINT, as it is stored, in [0, 2^64); else memoryview of the field's bytes
    """

    number: int
    kind: int
    value: int | memoryview


def write_varint(value: int) -> bytes:
    """An integer of 64 bits, seven bits a byte, the lowest first; negative ones as their two's complement."""
    value &= _WORD - 1
    out = bytearray()
    while value > 0x7F:
        out.append(value & 0x7F | 0x80)
        value >>= 7
    out.append(value)
    return bytes(out)


def varint_field(number: int, value: int) -> bytes:
    """A field that holds an integer, a truth value or an enumerator."""
    return write_varint(number << 3 | VARINT) + write_varint(value)


def float_field(number: int, value: float) -> bytes:
    """A field that holds a float32."""
    return write_varint(number << 3 | FIXED32) + struct.pack("<f", value)


def bytes_field(number: int, *parts: bytes | str) -> bytes:
    """A field that holds a text, raw bytes or another message; of several parts the whole, one after the other."""
    encoded = [part.encode() if isinstance(part, str) else part for part in parts]
    return b"".join((write_varint(number << 3 | BYTES), write_varint(sum(map(len, encoded))), *encoded))


def _read_varint(data: memoryview, start: int) -> tuple[int, int]:
    """The integer at `start` and where the next thing begins."""
    value = 0
    for k in range(10):
        if start + k >= len(data):
            raise ProtobufError("it ends within a number")
        byte = data[start + k]
        value |= (byte & 0x7F) << 7 * k
        if byte < 0x80:
            return value % _WORD, start + k + 1
    raise ProtobufError("a number has more than ten bytes")


def read_fields(data: bytes | memoryview) -> Iterator[Field]:
    """Fields of a message, in the order they are stored in; nothing is copied.

    Raises
    ------
    ProtobufError
        Where the bytes are no message, saying why.
    """
    view = memoryview(data)
    at = 0
    while at < len(view):
        key, at = _read_varint(view, at)
        number, kind = key >> 3, key & 7
        if number == 0:
            raise ProtobufError("a field has the number 0")
        if kind == VARINT:
            value, at = _read_varint(view, at)
            yield Field(number, kind, value)
            continue
        if kind == BYTES:
            size, at = _read_varint(view, at)
        elif kind in _FIXED_SIZES:
            size = _FIXED_SIZES[kind]
        else:
            raise ProtobufError(f"a field is of the unknown kind {kind}")
        if size > len(view) - at:
            raise ProtobufError("it ends within a field")
        yield Field(number, kind, view[at : at + size])
        at += size


def signed(field: Field) -> int:
    """A VARINT as an integer with a sign.

    Raises
    ------
    ProtobufError
        If the field holds something else.
    """
    if not isinstance(field.value, int):
        raise ProtobufError(f"field {field.number} is no number")
    return field.value - _WORD if field.value >= _WORD >> 1 else field.value


def content(field: Field) -> memoryview:
    """Bytes of a BYTES field.

    Raises
    ------
    ProtobufError
        If the field holds something else.
    """
    if field.kind != BYTES or isinstance(field.value, int):
        raise ProtobufError(f"field {field.number} holds no bytes")
    return field.value


def text(field: Field) -> str:
    """Text of a BYTES field.

    Raises
    ------
    ProtobufError
        If the field holds something else.
    """
    try:
        return bytes(content(field)).decode()
    except UnicodeDecodeError:
        raise ProtobufError(f"field {field.number} is no text") from None


def integers(field: Field) -> list[int]:
    """Integers of a repeated field: one by one, or packed into one."""
    if field.kind == VARINT:
        return [signed(field)]
    view, at, values = content(field), 0, []
    while at < len(view):
        value, at = _read_varint(view, at)
        values.append(value - _WORD if value >= _WORD >> 1 else value)
    return values
