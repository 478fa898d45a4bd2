# SPDX-License-Identifier: GPL-3.0-or-later
"""Whether a picture that Blender says it saved is really there, whole: on a full disk it says so of half a file."""

from __future__ import annotations

import re
import struct
from pathlib import Path

_PNG_END = b"\0\0\0\0IEND\xaeB`\x82"
_JPEG_END = b"\xff\xd9"
#: Ends TGA files of Blender's.
_TGA_END = b"TRUEVISION-XFILE.\0"
#: Where files say how large they are: their first bytes, the place of the number, its format, and what it leaves out.
_SIZES = (
    (b"RIFF", 4, "<I", 8),  # WebP
    (b"BM", 2, "<I", 0),
    (b"XPDS", 16, "<I", 0),  # DPX
    (b"SDPX", 16, ">I", 0),
    (b"\x80\x2a\x5f\xd7", 20, ">I", 0),  # Cineon
    (b"\xd7\x5f\x2a\x80", 20, "<I", 0),
)
_LARGEST_PREAMBLE = 24
#: What EXR, PNG and JPEG files have in front of their pixels where a render was cancelled: a field of the engine's.
_INTERRUPTED = re.compile(rb"neuralguide\.[^\0]{1,255}?\.ended_by(\0string\0....|\0|:)Cancelled", re.DOTALL)
#: Names of objects in front of that field take the most room [bytes].
_MOST_METADATA = 1 << 23
_TIFF_STRIP_OFFSETS, _TIFF_STRIP_BYTES = 273, 279
_EXR_MAGIC = 20000630
_EXR_TILED, _EXR_DEEP, _EXR_MULTIPART = 0x200, 0x800, 0x1000
#: Scan lines in a chunk by compression: none, RLE, ZIPS, ZIP, PIZ, PXR24, B44, B44A, DWAA, DWAB.
_EXR_CHUNK_LINES = (1, 1, 1, 16, 32, 16, 32, 32, 32, 256)


def is_whole(path: Path) -> bool:
    """False where a file ends too soon: empty, or a PNG, JPEG, OpenEXR, TIFF, WebP, TGA, BMP, DPX or Cineon file of
    which a part is missing. Other formats are taken at Blender's word.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    data_end = path.stat().st_size
    with path.open("rb") as file:
        preamble = file.read(_LARGEST_PREAMBLE)
        file.seek(4)
        start = preamble[:4]
        if start == b"\x89PNG":
            return _tail(path, len(_PNG_END)) == _PNG_END
        if start[:2] == b"\xff\xd8":
            return _tail(path, len(_JPEG_END)) == _JPEG_END
        if start == struct.pack("<I", _EXR_MAGIC):
            try:
                return _is_whole_exr(file, data_end)
            except (struct.error, ValueError, KeyError):
                return False
        if start in (b"II*\0", b"MM\0*"):
            try:
                return _is_whole_tiff(file, data_end, "<" if start[:1] == b"I" else ">")
            except struct.error:
                return False
    for magic, place, form, left_out in _SIZES:
        if preamble.startswith(magic):
            said = preamble[place : place + struct.calcsize(form)]
            return len(said) == struct.calcsize(form) and struct.unpack(form, said)[0] + left_out <= data_end
    if path.suffix.lower() == ".tga":
        return _tail(path, len(_TGA_END)) == _TGA_END
    return data_end > 0


def was_interrupted(path: Path) -> bool:
    """Whether a PNG, JPEG or OpenEXR file says that its render was cancelled before its end.

    Raises
    ------
    OSError
        If the file cannot be read.
    """
    with path.open("rb") as file:
        return _INTERRUPTED.search(file.read(_MOST_METADATA)) is not None


def was_written(path: Path, started: float) -> bool:
    """Whether the file is there, whole, and from a render that began then.

    Parameters
    ----------
    started : float
        [s] since the epoch. Up to two seconds earlier counts: clocks of file systems are coarse.
    """
    try:
        return path.stat().st_mtime >= started - 2.0 and is_whole(path)
    except OSError:
        return False


def _tail(path: Path, size: int) -> bytes:
    with path.open("rb") as file:
        file.seek(max(path.stat().st_size - size, 0))
        return file.read()


def _is_whole_exr(file, data_end: int) -> bool:  # type: ignore[no-untyped-def]
    """Every chunk of the offset table lies within the file.

    References: "OpenEXR File Layout", sections "Header", "Offset Tables" and "Scan line blocks".
    """
    version = struct.unpack("<I", file.read(4))[0]
    if version & (_EXR_TILED | _EXR_DEEP):
        return True
    is_multipart = bool(version & _EXR_MULTIPART)
    counts = []
    while header := _read_header(file):
        counts.append(_chunk_count(header))
        if not is_multipart:
            break
    offsets = struct.unpack(f"<{sum(counts)}Q", file.read(8 * sum(counts)))
    if not offsets or min(offsets) == 0:
        return False
    # A chunk begins with its part, if there are several, its first line and its size.
    file.seek(max(offsets) + (4 if is_multipart else 0) + 4)
    size = struct.unpack("<I", file.read(4))[0]
    return file.tell() + size <= data_end


def _is_whole_tiff(file, data_end: int, order: str) -> bool:  # type: ignore[no-untyped-def]
    """The first directory and all strips that it lists lie within the file.

    References: "TIFF 6.0", sections 2 and 8.
    """
    sizes = {3: "H", 4: "I"}
    (directory,) = struct.unpack(order + "I", file.read(4))
    if not 8 <= directory < data_end:
        return False
    file.seek(directory)
    (count,) = struct.unpack(order + "H", file.read(2))
    numbers = {}
    for tag, kind, length, place in struct.iter_unpack(order + "HHI4s", file.read(12 * count)):
        if tag in (_TIFF_STRIP_OFFSETS, _TIFF_STRIP_BYTES) and kind in sizes:
            form = f"{order}{length}{sizes[kind]}"
            if struct.calcsize(form) > len(place):
                file.seek(struct.unpack(order + "I", place)[0])
                place = file.read(struct.calcsize(form))
            numbers[tag] = struct.unpack(form, place[: struct.calcsize(form)])
    offsets, lengths = numbers.get(_TIFF_STRIP_OFFSETS, ()), numbers.get(_TIFF_STRIP_BYTES, ())
    return bool(offsets) and all(0 < first and first + size <= data_end for first, size in zip(offsets, lengths))


def _read_header(file) -> dict[str, bytes]:  # type: ignore[no-untyped-def]
    attributes = {}
    while name := _read_text(file):
        _read_text(file)  # its type
        size = struct.unpack("<I", file.read(4))[0]
        attributes[name] = file.read(size)
    return attributes


def _read_text(file) -> str:  # type: ignore[no-untyped-def]
    text = bytearray()
    while (byte := file.read(1)) != b"\0":
        if not byte:
            raise ValueError("the header ends in the middle")
        text += byte
    return text.decode("utf-8", "replace")


def _chunk_count(header: dict[str, bytes]) -> int:
    if "chunkCount" in header:
        return int(struct.unpack("<i", header["chunkCount"])[0])
    _, first, _, last = struct.unpack("<4i", header["dataWindow"])
    lines = _EXR_CHUNK_LINES[header["compression"][0]] if header["compression"][0] < len(_EXR_CHUNK_LINES) else 1
    return -(-(last - first + 1) // lines)
