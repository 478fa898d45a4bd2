# SPDX-License-Identifier: GPL-3.0-or-later
"""Which files are loaded as libraries."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from engine.runtime.blender_folders import find_libraries


@pytest.mark.skipif(os.name != "posix", reason="rights of another kind")
def test_libraries_are_not_taken_from_folders_for_all(tmp_path: Path) -> None:
    (path := tmp_path / "libanything.so").touch()
    assert find_libraries(("libanything*",), (tmp_path,)) == [path]
    tmp_path.chmod(0o1777)
    assert find_libraries(("libanything*",), (tmp_path,)) == []
