# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site: its page on installing is README.md's, links stay within it, every page listed exists."""

from __future__ import annotations

import re
from pathlib import Path

from tools.site_hooks import INSTALL_SECTIONS, ROOT, install_page, within_site


def test_the_page_on_installing_is_the_readmes() -> None:
    page = install_page((ROOT / "README.md").read_text("utf-8"))
    assert re.findall(r"^## (.+)$", page, re.MULTILINE) == list(INSTALL_SECTIONS)
    assert "](docs/" not in page and "Install from Disk" in page


def test_links_that_leave_the_site_become_text(tmp_path: Path) -> None:
    text = "[a](other.md#there) [b](../tests/test_docs.py) [c](https://d.e) ![f](images/g.png)"
    assert within_site(text, tmp_path, tmp_path) == "[a](other.md#there) b [c](https://d.e) ![f](images/g.png)"


def test_pages_that_the_site_lists_exist() -> None:
    listed = re.findall(r"[\w/-]+\.md$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert len(listed) > 10
    assert [name for name in listed if name != "install.md" and not (ROOT / "docs" / name).is_file()] == []
