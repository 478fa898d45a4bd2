# SPDX-License-Identifier: GPL-3.0-or-later
"""docs/nodes.md: it has every shader node of the Blender that runs, with what the engine says of each."""

from __future__ import annotations

from typing import Any

import pytest

from tools.nodes_page import BASE, PAGE, page

#: Blenders that have written the page.
WRITERS = (BASE, "5.3")


def test_the_page_is_the_one_that_is_generated(blender: Any) -> None:
    version = "{}.{}".format(*blender.app.version)
    if version not in WRITERS:
        pytest.skip(f"the page is that of Blender {' and '.join(WRITERS)}")
    known = PAGE.read_text("utf-8")
    assert known == page(version, known), "run python -m tools.nodes_page"
