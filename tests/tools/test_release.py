# SPDX-License-Identifier: GPL-3.0-or-later
"""What a release is checked by, and the workflow that runs it."""

from __future__ import annotations

import hashlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tools import build_extension, kernel_library, release
from tools.blender_ranges import ROOT

WORKFLOW = ROOT / ".github/workflows/release.yml"


def test_a_tag_is_of_the_manifests_version(capsys: pytest.CaptureFixture[str]) -> None:
    version = release.manifest_version()
    assert release.main(["check", f"v{version}"]) == 0
    assert release.main(["check", "v99.0.0"]) == 1
    assert f"tag v{version}" in capsys.readouterr().err


def test_a_whole_set_has_checksums_and_a_part_has_none(tmp_path: Path) -> None:
    names = release.expected_zips("1.2.3")
    assert len(names) == len(release.RANGES) * len(build_extension.PLATFORMS)
    for number, name in enumerate(names):
        (tmp_path / name).write_bytes(bytes([number]))
    lines = release.write_checksums(tmp_path, "1.2.3").read_text("ascii").splitlines()
    assert lines == [f"{hashlib.sha256(bytes([n])).hexdigest()}  {name}" for n, name in enumerate(names)]
    (tmp_path / "neuralguide-1.2.2-old.zip").touch()
    with pytest.raises(ValueError, match=r"not of 1\.2\.3: neuralguide-1\.2\.2-old\.zip"):
        release.write_checksums(tmp_path, "1.2.3")
    (tmp_path / names[0]).unlink()
    with pytest.raises(ValueError, match=f"lacks {re.escape(names[0])}"):
        release.write_checksums(tmp_path, "1.2.3")


def test_notes_are_the_versions_part_of_the_changelog() -> None:
    text = "# Changelog\n\n## 1.1.0 (unreleased)\n\n- new\n\n## 1.0.0\n\n- old\n"
    assert release.notes(text, "1.1.0") == "- new"
    assert release.notes(text, "1.0.0") == "- old"
    assert release.notes(text, "1.0") == ""


def test_the_workflow_is_pinned_and_its_commands_exist() -> None:
    text = WORKFLOW.read_text("utf-8")
    uses = re.findall(r"uses: (\S+)", text)
    assert len(uses) >= 3 and all(re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", action) for action in uses)
    assert "secrets." not in text, "the default token is enough"
    assert text.index("contents: read") < text.index("jobs:") and text.count("contents: write") == 1
    makefile = (ROOT / "Makefile").read_text("utf-8")
    for target in ("extension", ".venv/installed"):
        assert re.search(rf"^{re.escape(target)}:", makefile, re.MULTILINE) and target in text
    for command in ("check", "checksums", "notes"):
        assert f"tools/release.py {command}" in text


def test_commands_run_as_the_workflow_writes_them() -> None:
    tag = f"v{release.manifest_version()}"
    for arguments in (["check", tag], ["notes"]):
        done = subprocess.run(
            [sys.executable, "tools/release.py", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
        )
        assert done.returncode == 0, done.stderr


def test_a_quick_build_compiles_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    asked = []

    def build(blenders: object, platform: str, output: Path, parts: object) -> Path:
        asked.append(parts)
        return output

    monkeypatch.setattr(build_extension, "build", build)
    for option in ([], ["--quick"], ["--no-kernels"]):
        monkeypatch.setattr(sys, "argv", ["build_extension.py", "--blender", "4.5", "--platform", "linux-x64", *option])
        assert build_extension.main() == 0
    assert asked == [kernel_library.PARTS, (), ()]


def test_compiling_ahead_knows_what_each_part_takes() -> None:
    assert {part for row in kernel_library.PARTS for part in row} == set(kernel_library.SECONDS)
