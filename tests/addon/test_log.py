# SPDX-License-Identifier: GPL-3.0-or-later
"""Where tracebacks go: to a file whose name nobody else could have taken before."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

pytestmark = pytest.mark.skipif(os.name != "posix", reason="rights of another kind")


def test_the_log_lies_beside_the_cache(blender, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.log import log_file

    monkeypatch.setenv("NEURALGUIDE_KERNEL_CACHE", str(tmp_path / "kernels"))
    assert log_file() == tmp_path / "neuralguide.log"


def test_but_not_where_others_could_have_put_a_link(blender, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from addon.log import log_failure, log_file

    (shared := tmp_path / "shared").mkdir()
    (victim := tmp_path / "victim").write_text("precious")
    (shared / "neuralguide.log").symlink_to(victim)
    monkeypatch.setenv("NEURALGUIDE_KERNEL_CACHE", str(shared / "kernels"))
    (shared / "kernels").mkdir()
    shared.chmod(0o1777)
    path = log_file()
    assert path == log_file() and path.parent != shared and path.stat().st_mode & 0o777 == 0o600
    try:
        raise ValueError("a failure")
    except ValueError:
        assert log_failure("words") == path
    assert "a failure" in path.read_text() and victim.read_text() == "precious"
    path.write_text("")
