# SPDX-License-Identifier: GPL-3.0-or-later
"""A field of metadata is set, and everything else of a file stays as it is, lossy pixels bit for bit."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import numpy as np
import OpenEXR
import pytest

from addon.exr_layers import LayersError
from addon.exr_metadata import set_text

FIELD = "neuralguide.light_mix"
CODECS = {
    name: getattr(OpenEXR, f"{name}_COMPRESSION") for name in ("NO", "ZIP", "PIZ", "DWAA", "DWAB", "B44", "PXR24")
}


def write(path: Path, codec: Any, parts: int, kind: Any = OpenEXR.scanlineimage) -> None:
    """A file of one part or several; its height is no multiple of what codecs take together."""
    rng = np.random.default_rng(3)

    def part(index: int) -> OpenEXR.Part:
        header = {"compression": codec, "type": kind, "artist": "Anna", FIELD: "{}"}
        if kind == OpenEXR.tiledimage:
            header["tiles"] = OpenEXR.TileDescription()
        channels = {f"Layer.Pass{index}.{letter}": rng.random((301, 40), np.float32) for letter in "RGB"}
        return OpenEXR.Part(header, channels, f"part {index}")

    with OpenEXR.File([part(index) for index in range(parts)]) as file:
        file.write(str(path))


def read(path: Path) -> list[tuple[dict[str, Any], dict[str, np.ndarray]]]:
    """Header and channels of each part."""
    with OpenEXR.File(str(path), separate_channels=True) as file:
        return [
            (dict(part.header), {name: np.array(channel.pixels) for name, channel in part.channels.items()})
            for part in file.parts
        ]


@pytest.mark.parametrize("parts", [1, 3])
@pytest.mark.parametrize("codec", CODECS)
def test_everything_else_stays_as_it_is(codec: str, parts: int, tmp_path: Path) -> None:
    path = tmp_path / "f.exr"
    write(path, CODECS[codec], parts)
    before = read(path)
    for text in ('{"Küche": [1, 2, 3]}', "", "x" * 5000):
        set_text(path, FIELD, text)
        after = read(path)
        assert len(after) == len(before) == parts
        for (header, channels), (old_header, old_channels) in zip(after, before, strict=True):
            assert header.pop(FIELD) == text
            assert str(header) == str({name: value for name, value in old_header.items() if name != FIELD})
            assert channels.keys() == old_channels.keys()
            for name, pixels in channels.items():
                assert np.array_equal(pixels, old_channels[name]), name
    assert os.listdir(tmp_path) == ["f.exr"]


def test_tiles_stay_too(tmp_path: Path) -> None:
    path = tmp_path / "f.exr"
    write(path, OpenEXR.ZIP_COMPRESSION, 1, OpenEXR.tiledimage)
    ((_, before),) = read(path)
    set_text(path, FIELD, "longer than it was")
    ((header, after),) = read(path)
    assert header[FIELD] == "longer than it was"
    assert all(np.array_equal(after[name], pixels) for name, pixels in before.items())


@pytest.mark.parametrize("length", [0, 4, 9, 60, 400, 1200])
def test_a_file_that_is_not_whole_is_left_alone(length: int, tmp_path: Path) -> None:
    path = tmp_path / "f.exr"
    write(path, OpenEXR.ZIP_COMPRESSION, 1)
    os.truncate(path, length)
    before = path.read_bytes()
    with pytest.raises(LayersError, match=r"f\.exr is damaged, or no OpenEXR"):
        set_text(path, FIELD, "new")
    assert path.read_bytes() == before
    assert os.listdir(tmp_path) == ["f.exr"]


def test_what_is_no_file_is_said(tmp_path: Path) -> None:
    with pytest.raises(LayersError, match="cannot be written"):
        set_text(tmp_path / "none.exr", FIELD, "new")
    (tmp_path / "picture.exr").write_bytes(b"\x89PNG and more")
    with pytest.raises(LayersError, match="does not begin as one"):
        set_text(tmp_path / "picture.exr", FIELD, "new")
