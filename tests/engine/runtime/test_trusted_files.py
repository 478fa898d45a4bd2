# SPDX-License-Identifier: GPL-3.0-or-later
"""Code that others could have written is not run."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from engine.runtime.kernel_library import KernelLibrary
from engine.runtime.trusted_files import make_folder, read_trusted, weakness, write_trusted

pytestmark = pytest.mark.skipif(os.name != "posix", reason="rights of another kind")
#: Anybody but root and whoever runs the tests.
STRANGER = 54321
as_root = pytest.mark.skipif(os.name != "posix" or os.geteuid() != 0, reason="only root gives files away")


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    made = tmp_path / "above" / "folder"
    make_folder(made)
    return made


def test_a_folder_of_ones_own_is_trusted(folder: Path) -> None:
    assert weakness(folder) == ""
    folder.parent.chmod(0o1777)
    assert weakness(folder) == "", "others may not rename what is not theirs there"
    (link := folder.parent / "link").symlink_to("../above/folder")
    assert weakness(link) == ""


@pytest.mark.parametrize("mode", [0o777, 0o1777, 0o757, 0o702])
def test_a_folder_that_others_write_to_is_not_trusted(folder: Path, mode: int) -> None:
    (link := folder.parent / "link").symlink_to(folder)
    folder.chmod(mode)
    assert weakness(folder) == weakness(link) == f"{folder} can be written by others"


@as_root
@pytest.mark.parametrize("mode", [0o775, 0o770, 0o2775, 0o1770])
def test_a_folder_that_a_group_writes_to_is_not_trusted(folder: Path, mode: int) -> None:
    folder.chmod(mode)
    assert "can be written by others" in weakness(folder)


def test_nor_is_one_that_others_could_put_another_in_place_of(folder: Path) -> None:
    folder.parent.chmod(0o777)
    assert weakness(folder) == f"{folder.parent} can be written by others"
    assert weakness(folder / ".." / "folder") == f"{folder.parent} can be written by others"


def test_nor_is_one_that_is_reached_by_a_link_that_leads_through_such(folder: Path, tmp_path: Path) -> None:
    (tmp_path / "link").symlink_to(folder)
    folder.parent.chmod(0o777)
    assert "can be written by others" in weakness(tmp_path / "link")
    (tmp_path / "round").symlink_to(tmp_path / "round")
    with pytest.raises(OSError, match="symbolic links"):
        weakness(tmp_path / "round")


@as_root
def test_nor_is_what_belongs_to_another_user(folder: Path, tmp_path: Path) -> None:
    os.chown(folder.parent, STRANGER, STRANGER)
    assert weakness(folder) == f"{folder.parent} belongs to another user"
    os.chown(folder.parent, 0, 0)
    os.chown(folder, STRANGER, STRANGER)
    assert weakness(folder) == f"{folder} belongs to another user"
    os.chown(folder, 0, 0)
    (link := tmp_path / "link").symlink_to(folder)
    os.lchown(link, STRANGER, STRANGER)
    assert weakness(link) == f"{link} belongs to another user"
    write_trusted(folder / "file", b"code")
    os.chown(folder / "file", STRANGER, STRANGER)
    assert read_trusted(folder / "file") is None


def test_whatever_the_umask_only_this_user_may_write(tmp_path: Path) -> None:
    previous = os.umask(0)
    try:
        make_folder(made := tmp_path / "a" / "b" / "c")
        write_trusted(made / "file", b"code")
    finally:
        os.umask(previous)
    assert weakness(made) == "" and read_trusted(made / "file") == b"code"
    assert [path.name for path in made.iterdir()] == ["file"]


def test_files_that_others_may_write_are_missing(folder: Path) -> None:
    path = folder / "file"
    assert read_trusted(path) is None
    write_trusted(path, b"code")
    path.chmod(0o646)
    assert read_trusted(path) is None
    path.chmod(0o644)
    assert read_trusted(path) == b"code"
    folder.chmod(0o777)
    assert read_trusted(path) is None


def test_nobody_waits_for_a_pipe(folder: Path) -> None:
    os.mkfifo(folder / "pipe", 0o600)
    assert read_trusted(folder / "pipe") is None


def test_a_library_that_others_may_write_is_not_opened(folder: Path) -> None:
    (index := folder / "py311-x86-64-v3.index").write_bytes(b"{}\n{}")
    index.chmod(0o666)
    with pytest.raises(ValueError, match="can be written by others"):
        KernelLibrary(index)
    index.chmod(0o644)
    with pytest.raises(ValueError, match="damaged"):
        KernelLibrary(index)
    folder.chmod(0o777)
    with pytest.raises(ValueError, match="can be written by others"):
        KernelLibrary(index)
