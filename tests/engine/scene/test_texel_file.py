# SPDX-License-Identifier: GPL-3.0-or-later
"""Textures in a file: the same values, nothing left behind, a sentence where there is no room."""

from __future__ import annotations

import errno
import shutil
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.scene.description import Image
from engine.scene.texel_file import TexelFile
from engine.shaders.image_pool import build_image_pool

TEMPORARY_FILE = tempfile.TemporaryFile


def make_images(folder: str = "") -> list[Image]:
    """A byte image that alpha changes, one that it leaves alone, and a float image; all of different values."""
    generator = np.random.default_rng(3)
    first, second = (generator.integers(0, 256, (5, 7, 4), np.uint8) for _ in range(2))
    third = generator.random((3, 2, 4), np.float32)
    return [
        Image("a", "straight", first, folder=folder),
        Image("b", "packed", second, alpha_mode="CHANNEL_PACKED"),
        Image("c", "float", third, "LINEAR", is_associated=True),
    ]


def test_values_written_are_read(tmp_path: Path) -> None:
    file = TexelFile(10, np.float32, str(tmp_path))
    file.write(4, np.arange(6, dtype=np.float32))
    file.let_go()
    np.testing.assert_array_equal(file.values, [0, 0, 0, 0, 0, 1, 2, 3, 4, 5])


def test_arrays_outlive_their_file_object(tmp_path: Path) -> None:
    values = TexelFile(3, np.uint8, str(tmp_path)).values
    values[:] = 7
    assert values.tolist() == [7, 7, 7]


@pytest.mark.skipif("os.name == 'nt'", reason="there files keep their name until they are closed")
def test_nothing_is_left_behind_even_by_a_killed_process(tmp_path: Path) -> None:
    file = TexelFile(3, np.uint8, str(tmp_path))
    assert list(tmp_path.iterdir()) == []
    del file


def test_a_pool_in_a_file_is_the_pool_in_memory(tmp_path: Path) -> None:
    in_memory, in_file = build_image_pool(make_images()), build_image_pool(make_images(str(tmp_path)))
    assert in_file.files and not in_memory.files
    np.testing.assert_array_equal(in_file.table, in_memory.table)
    np.testing.assert_array_equal(in_file.pixels_byte, in_memory.pixels_byte)
    np.testing.assert_array_equal(in_file.pixels_float, in_memory.pixels_float)
    # Read anew after they were let go.
    in_file.keep_within(0)
    np.testing.assert_array_equal(in_file.pixels_byte, in_memory.pixels_byte)


def test_images_that_alpha_leaves_alone_are_kept_once(tmp_path: Path) -> None:
    images = make_images(str(tmp_path))
    pool = build_image_pool(images)
    assert [np.shares_memory(image.pixels, pool.pixels_byte) for image in images] == [False, True, False]
    assert np.shares_memory(images[2].pixels, pool.pixels_float)


def test_a_full_disk_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    usage = shutil.disk_usage(tmp_path)
    monkeypatch.setattr(shutil, "disk_usage", lambda _folder: usage._replace(free=10))
    with pytest.raises(ValueError, match=r"textures do not fit into memory, and .* has no room for 0.0 GiB"):
        build_image_pool(make_images(str(tmp_path)))


class FullFile:
    """A file on a disk that has just become full."""

    def __init__(self, **arguments: Any) -> None:
        self.file = TEMPORARY_FILE(**arguments)

    def __getattr__(self, name: str) -> Any:
        return getattr(self.file, name)

    def write(self, _data: Any) -> int:
        raise OSError(errno.ENOSPC, "No space left on device")


def test_a_disk_that_fills_meanwhile_is_a_sentence(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tempfile, "TemporaryFile", FullFile)
    with pytest.raises(ValueError, match="has no room"):
        build_image_pool(make_images(str(tmp_path)))


def test_a_folder_that_cannot_be_written_to_is_a_sentence(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="no file can be made for them in"):
        TexelFile(4, np.uint8, str(tmp_path / "missing"))
