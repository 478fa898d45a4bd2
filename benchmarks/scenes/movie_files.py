# SPDX-License-Identifier: GPL-3.0-or-later
"""Writes movies: AVI files of uncompressed frames, which any Blender reads without loss."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np

_FRAMES_PER_SECOND = 24
#: The file has an index, and what is shown lasts as long as frames say.
_HAS_INDEX, _KEYFRAME = 0x10, 0x10


def _chunk(name: bytes, content: bytes) -> bytes:
    return name + struct.pack("<I", len(content)) + content + b"\0" * (len(content) % 2)


def _list(name: bytes, *chunks: bytes) -> bytes:
    return _chunk(b"LIST", name + b"".join(chunks))


def write_movie(path: Path, frames: np.ndarray) -> None:
    """Write frames as an AVI file (Microsoft's "AVI RIFF File Reference", 1996).

    Parameters
    ----------
    frames : uint8 (frames, height, width, 3)
        Red, green and blue, row 0 at the bottom.
    """
    count, height, width, _ = frames.shape
    # Blue comes first, and rows are as long as a multiple of four bytes.
    padding = -3 * width % 4
    rows = np.pad(frames[..., ::-1].reshape(count, height, 3 * width), ((0, 0), (0, 0), (0, padding)))
    size = rows[0].size
    header = struct.pack(
        "<14I", 1_000_000 // _FRAMES_PER_SECOND, size * _FRAMES_PER_SECOND, 0, _HAS_INDEX, count, 0, 1, size, width,
        height, 0, 0, 0, 0,
    )  # fmt: skip
    stream = struct.pack(
        "<4s4sIHHIIIIIIII4H", b"vids", b"DIB ", 0, 0, 0, 0, 1, _FRAMES_PER_SECOND, 0, count, size, 0xFFFFFFFF, 0, 0, 0,
        width, height,
    )  # fmt: skip
    format_ = struct.pack("<IiiHHIIiiII", 40, width, height, 1, 24, 0, size, 0, 0, 0, 0)
    headers = _list(b"hdrl", _chunk(b"avih", header), _list(b"strl", _chunk(b"strh", stream), _chunk(b"strf", format_)))
    chunks = [_chunk(b"00db", row.tobytes()) for row in rows]
    starts = 4 + np.cumsum([0, *(len(chunk) for chunk in chunks[:-1])])
    index = b"".join(struct.pack("<4sIII", b"00db", _KEYFRAME, start, size) for start in starts)
    content = headers + _list(b"movi", *chunks) + _chunk(b"idx1", index)
    path.write_bytes(_chunk(b"RIFF", b"AVI " + content))
