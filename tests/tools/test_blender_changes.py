# SPDX-License-Identifier: GPL-3.0-or-later
"""What two Blenders have is listed and compared."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from tools.blender_changes import compare, main

ROOT = Path(__file__).resolve().parents[2]


def test_what_is_new_gone_and_another_is_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    old = {"Node input 'A'": "VALUE 0", "Node.kind = X": "X", "Object.same": "INT"}
    new = {"Node input 'A'": "VALUE 1", "Node.kind = Y": "Y", "Object.same": "INT"}
    told = ["~ Node input 'A': VALUE 0 -> VALUE 1", "- Node.kind = X: X", "+ Node.kind = Y: Y"]
    assert compare(old, new) == told
    assert compare(old, old) == []
    for name, listing in (("old", old), ("new", new)):
        (tmp_path / name).write_text(json.dumps(listing))
    assert main(["compare", str(tmp_path / "old"), str(tmp_path / "new")]) == 0
    assert capsys.readouterr().out.splitlines() == told


def test_this_blender_is_listed_with_sockets_menus_settings_and_cycles(tmp_path: Path) -> None:
    pytest.importorskip("bpy")
    # In a process of its own, as it is used: the list begins with factory settings.
    command = [sys.executable, "-m", "tools.blender_changes", "list", str(tmp_path / "list.json")]
    subprocess.run(command, cwd=ROOT, check=True, capture_output=True, timeout=120)
    listing = json.loads((tmp_path / "list.json").read_text())
    assert listing["ShaderNodeBsdfDiffuse input 'Roughness'"] == "VALUE 0"
    assert listing["ShaderNodeMath.operation = MULTIPLY_ADD"] == "Multiply Add"
    assert listing["RenderSettings.use_motion_blur"] == "BOOLEAN"
    assert listing["CyclesRenderSettings.sample_clamp_indirect"] == "FLOAT"
    assert listing["RenderEngine.report()"] == "type, message"
    assert not any(name.startswith(("NODE_PT_", "RENDER_PT_", "ThemeView3D")) for name in listing)
