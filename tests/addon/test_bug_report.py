# SPDX-License-Identifier: GPL-3.0-or-later
"""A report of a bug has what is asked for first, and nothing of who the user is."""

from __future__ import annotations

import platform
import tomllib
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]


def test_it_names_versions_processor_and_the_end_of_the_log(
    blender: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    from addon import bug_report

    log = tmp_path / "neuralguide.log"
    log.write_text("".join(f"line {number}\n" for number in range(500)), "utf-8")
    monkeypatch.setattr(bug_report, "log_file", lambda: log)
    text = bug_report.bug_report()
    lines = dict(line.partition(": ")[::2] for line in text.splitlines() if not line.startswith(" "))
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    assert lines["NeuralGuide"] == manifest["version"]
    assert lines["Blender"].startswith(blender.app.version_string) and lines["Python"] == platform.python_version()
    assert "threads" in lines["Processor"] and len(lines["Processor"]) > len("2 threads")
    assert "numba 0" in lines["Packages"] and "GiB" in lines["Memory"]
    assert "  line 499" in text and "  line 0\n" not in text


def test_it_does_not_say_who_the_user_is(blender: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from addon import bug_report

    log = tmp_path / "ada" / "neuralguide.log"
    log.parent.mkdir()
    log.write_text(f"{log.parent}/secret.blend cannot be read\n", "utf-8")
    monkeypatch.setattr(bug_report, "log_file", lambda: log)
    monkeypatch.setenv("HOME", str(log.parent))
    text = bug_report.bug_report()
    assert "ada" not in text and "~/secret.blend" in text


def test_without_a_log_it_says_so(blender: Any, monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    from addon import bug_report

    monkeypatch.setattr(bug_report, "log_file", lambda: tmp_path / "none.log")
    assert "(nothing was logged)" in bug_report.bug_report()


def test_the_command_line_prints_it(capsys: pytest.CaptureFixture[str]) -> None:
    from addon.__main__ import main

    assert main(["--report"]) == 0
    printed = capsys.readouterr().out
    assert printed.startswith("NeuralGuide: ") and "Log: " in printed
    assert main(["--version"]) == 0
    assert "NeuralGuide " in capsys.readouterr().out


def test_the_template_asks_for_it() -> None:
    template = (ROOT / ".github/ISSUE_TEMPLATE/bug_report.md").read_text("utf-8")
    assert "Copy Bug Report" in template and "--report" in template
