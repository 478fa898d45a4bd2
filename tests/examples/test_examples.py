# SPDX-License-Identifier: GPL-3.0-or-later
"""The examples do what they say."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from engine.guiding.saved.file import load_field
from examples import read_passes, render_description, saved_field, turntable

EXAMPLES = Path(read_passes.__file__).parent


def picture(path: Path) -> np.ndarray:
    """Pixels of a PNG, row 0 at the top."""
    return np.asarray(Image.open(path)).astype(float)


def test_a_description_becomes_a_picture(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    render_description.main(tmp_path)
    seen = picture(tmp_path / "room.png")
    assert seen.shape == (64, 96, 3)
    # The middle has the red tower left of the blue block, before white walls under a warm lamp.
    tower, block, wall = seen[24:30, 40:46], seen[34:40, 48:54], seen[2:10, 60:90]
    assert tower[..., 0].mean() > 2.0 * tower[..., 2].mean()
    assert block[..., 2].mean() > 1.5 * block[..., 0].mean()
    assert wall.mean() > 60.0 and wall[..., 0].mean() > wall[..., 2].mean()
    assert "64 samples a pixel" in capsys.readouterr().out


def test_a_saved_field_saves_noise(tmp_path: Path) -> None:
    with_field, without = saved_field.main(tmp_path)
    assert with_field < 0.85 * without
    assert load_field(tmp_path / "room.ngfield").samples == 127


def test_all_frames_of_a_turntable_start_from_one_field(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    starts = []

    class Watched(turntable.Session):
        def render(self, **named: Any) -> Any:
            starts.append(named.get("start"))
            return super().render(**named)

    monkeypatch.setattr(turntable, "Session", Watched)
    paths = turntable.main(tmp_path, frame_count=2)
    first, field, again = starts
    assert first is None and field is not None and again is field
    front, back = map(picture, paths)
    assert np.abs(front - back).mean() > 5.0, "the camera has gone around"
    assert "learned from" in capsys.readouterr().out


def test_passes_are_read(tmp_path: Path) -> None:
    import addon

    try:
        passes = read_passes.main(tmp_path)
    finally:
        addon.unregister()
    assert {name: image.shape[2] for name, image in passes.items()} == {
        "Combined": 4, "Noisy Image": 4, "Normal": 3, "Albedo": 3, "Sample Count": 1, "Variance": 3,
    }  # fmt: skip
    assert all(image.shape[:2] == (54, 96) for image in passes.values())
    # Row 0 is the top, and x, y, z are in order: where the cube's upper face is, normals look up.
    upper = passes["Normal"][20, 48]
    assert upper[2] > 0.95 and np.abs(upper[:2]).max() < 0.2
    assert 1.0 <= passes["Sample Count"].max() <= 64.0
    assert passes["Variance"].max() > 0.0


def test_the_page_of_examples_has_them_all() -> None:
    page = (EXAMPLES / "README.md").read_text("utf-8")
    scripts = {file.name for file in EXAMPLES.glob("*.py")} - {"__init__.py"}
    assert set(re.findall(r"\]\((\w+\.py)\)", page)) == scripts
    assert set(re.findall(r"-m examples\.(\w+)", page)) <= {name.removesuffix(".py") for name in scripts}
