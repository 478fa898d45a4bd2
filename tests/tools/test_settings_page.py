# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/settings.md says what the declarations say."""

from __future__ import annotations

from addon.declared_settings import SCENE_SETTINGS
from tools.settings_page import PAGE, page


def test_the_page_is_the_one_that_is_generated() -> None:
    assert PAGE.read_text("utf-8") == page(), "run python -m tools.settings_page"


def test_every_setting_has_one_line() -> None:
    lines = page().split("\n")
    for name, setting in SCENE_SETTINGS.items():
        (line,) = [text for text in lines if text.startswith(f"- `{name}` (")]
        assert setting.sentence in line
