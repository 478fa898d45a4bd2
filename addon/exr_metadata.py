# SPDX-License-Identifier: GPL-3.0-or-later
"""Changing a field of an OpenEXR file's metadata without touching its pixels.

Writing a file anew would compress it anew, which codecs such as DWAA do with loss. Pixels are therefore copied as they
lie there, behind headers that say more, and only the table of where they lie is made anew. The layout of the file is
that of https://openexr.com/en/latest/OpenEXRFileLayout.html.
"""

from __future__ import annotations

import contextlib
import os
import shutil
import struct
from pathlib import Path
from typing import BinaryIO

import numpy as np

from .exr_layers import LayersError

_MAGIC = bytes((0x76, 0x2F, 0x31, 0x01))
_HAS_PARTS = 0x1000
_TEXT = b"string"
#: What all headers together may take [bytes]; a file whose headers end nowhere is read no further.
_MOST_HEADER = 1 << 26


class _Damaged(ValueError):
    """A file does not lie as it should."""


def set_text(path: Path, field: str, text: str) -> None:
    """Set a field of text in all headers of a file. It is replaced once it is whole.

    Parameters
    ----------
    path : Path
    field : str
        At most 31 characters of ASCII: more need a mark that older readers do not know.
    text : str

    Raises
    ------
    LayersError
        If the file is not whole or no OpenEXR, or cannot be written.
    """
    unfinished = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        with path.open("rb") as source, unfinished.open("wb") as target:
            _copy(source, target, field.encode("ascii"), text.encode())
        shutil.copymode(path, unfinished)
        os.replace(unfinished, path)
    except (_Damaged, struct.error) as error:
        raise LayersError(f"{path} is damaged, or no OpenEXR: {error}") from None
    except OSError as error:
        raise LayersError(f"{path} cannot be written: {error.strerror or error}") from None
    finally:
        with contextlib.suppress(OSError):
            unfinished.unlink(missing_ok=True)


def _copy(source: BinaryIO, target: BinaryIO, field: bytes, text: bytes) -> None:
    """Copy a file with a field set."""
    head = source.read(8)
    if head[:4] != _MAGIC or len(head) < 8:
        raise _Damaged("it does not begin as one")
    has_parts = bool(struct.unpack("<I", head[4:])[0] & _HAS_PARTS)
    headers = bytearray()
    while (attributes := _read_header(source, field)) is not None:
        value = field + b"\0" + _TEXT + b"\0" + struct.pack("<i", len(text)) + text
        headers += attributes + value + b"\0"
        if not has_parts:
            break
    headers += b"\0" if has_parts else b""
    start = source.tell()
    offsets = _read_offsets(source, start)
    target.write(head)
    target.write(headers)
    target.write((offsets + np.uint64(len(head) + len(headers)) - np.uint64(start)).tobytes())
    shutil.copyfileobj(source, target)


def _read_header(source: BinaryIO, without: bytes) -> bytes | None:
    """Attributes of the next header but one, as they lie there; None where there is no further header."""
    kept = bytearray()
    is_first = True
    while name := _read_name(source):
        kind, size = _read_name(source), struct.unpack("<i", source.read(4))[0]
        if not 0 <= size < _MOST_HEADER:
            raise _Damaged(f"its attribute {name.decode('latin-1')} has {size} bytes")
        value = source.read(size)
        if len(value) < size or source.tell() > _MOST_HEADER:
            raise _Damaged("its headers do not end")
        if name != without:
            kept += name + b"\0" + kind + b"\0" + struct.pack("<i", size) + value
        is_first = False
    return None if is_first else bytes(kept)


def _read_name(source: BinaryIO) -> bytes:
    name = bytearray()
    while (letter := source.read(1)) != b"\0":
        if not letter or len(name) > 255:
            raise _Damaged("its headers do not end")
        name += letter
    return bytes(name)


def _read_offsets(source: BinaryIO, start: int) -> np.ndarray:
    """Where pieces of pixels lie: a table that ends where the first of them begins, whatever codec and tiles there are.

    Leaves the file at its end.
    """
    first = int.from_bytes(source.read(8), "little")
    length = os.fstat(source.fileno()).st_size
    if not start < first < length:
        raise _Damaged("it is not whole")
    source.seek(start)
    entries = np.frombuffer(source.read((first - start) // 8 * 8), "<u8")
    ends = np.uint64(start) + np.uint64(8) * np.arange(1, len(entries) + 1, dtype=np.uint64)
    (found,) = np.nonzero(np.minimum.accumulate(entries) == ends)
    if not len(found):
        raise _Damaged("it is not whole")
    offsets = entries[: found[0] + 1]
    if int(offsets.max()) >= length:
        raise _Damaged("it is not whole")
    source.seek(start + offsets.nbytes)
    return offsets
