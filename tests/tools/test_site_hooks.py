# SPDX-License-Identifier: GPL-3.0-or-later
"""The documentation site: its page on installing is README.md's, links stay within it, every page listed exists."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from tools.site_hooks import (
    EXAMPLES,
    INSTALL_SECTIONS,
    ROOT,
    examples_page,
    install_page,
    on_config,
    repository_address,
    with_titles,
    within_made_pages,
    within_site,
)


def test_the_page_on_installing_is_the_readmes() -> None:
    page = install_page((ROOT / "README.md").read_text("utf-8"))
    assert re.findall(r"^## (.+)$", page, re.MULTILINE) == list(INSTALL_SECTIONS)
    assert "](docs/" not in page and "Install from Disk" in page


def test_links_that_leave_the_site_become_text(tmp_path: Path) -> None:
    text = "[a](other.md#there) [b](../tests/test_docs.py) [c](https://d.e) ![f](images/g.png)"
    assert within_site(text, tmp_path, tmp_path) == "[a](other.md#there) b [c](https://d.e) ![f](images/g.png)"


def test_links_to_what_is_made_a_page_stay_within_the_site() -> None:
    text = "[Install](../README.md#install-it-in-blender) [Limits](../README.md#limits) [all](../README.md#read-on)"
    assert within_made_pages(text) == "[Install](install.md#install-it-in-blender) [Limits](install.md#limits) " + (
        "[all](../README.md#read-on)"
    )
    assert within_made_pages("[a](../examples/README.md)") == "[a](examples.md)"


def test_the_page_of_examples_shows_the_scripts() -> None:
    page = examples_page(EXAMPLES)
    for script in EXAMPLES.glob("[!_]*.py"):
        anchor = script.name.replace(".", "")
        assert f"## {script.name}\n" in page and f"](#{anchor})" in page and script.read_text("utf-8").rstrip() in page


def test_installing_begins_with_the_zip_and_three_clicks() -> None:
    for page in ("README.md", "docs/index.md"):
        text = (ROOT / page).read_text("utf-8")
        steps = re.search(r"^## Install[^\n]*\n(.*?)(?=^## |\Z)", text, re.MULTILINE | re.DOTALL)
        assert steps is not None, page
        numbered = re.findall(r"^\d\. (.*)", steps.group(1), re.MULTILINE)
        assert len(numbered) == 3 and numbered[0].startswith("Download the zip") and "make" not in numbered[0], page


def test_links_show_titles_and_not_files(tmp_path: Path) -> None:
    (tmp_path / "farm.md").write_text("# Several machines\n\ntext\n", "utf-8")
    text = "[docs/farm.md](farm.md) [`farm.md`](farm.md#start) [how](farm.md) [gone.md](gone.md)"
    shown = "[Several machines](farm.md) [Several machines](farm.md#start) [how](farm.md) [gone.md](gone.md)"
    assert with_titles(text, tmp_path) == shown
    page = with_titles(install_page((ROOT / "README.md").read_text("utf-8")), ROOT / "docs")
    assert not re.search(r"\[[^\]]*\.md\]", page)


@pytest.mark.parametrize(
    ("remote", "address"),
    [
        ("git@example.org:ada/neuralguide.git", "https://example.org/ada/neuralguide"),
        ("https://example.org/ada/neuralguide", "https://example.org/ada/neuralguide"),
        ("https://token@example.org/ada/neuralguide.git\n", "https://example.org/ada/neuralguide"),
        ("ssh://git@example.org/ada/neuralguide.git", "https://example.org/ada/neuralguide"),
        ("/srv/git/neuralguide", ""),
        ("", ""),
    ],
)
def test_a_remote_is_an_address_for_browsers_or_none(remote: str, address: str) -> None:
    assert repository_address(remote) == address


def test_every_page_knows_version_and_repository(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("GITHUB_SERVER_URL", "https://example.org")
    monkeypatch.setenv("GITHUB_REPOSITORY", "ada/neuralguide")
    config = on_config({"extra": {}})
    assert re.fullmatch(r"\d+\.\d+\.\d+", config["extra"]["version"])
    assert config["repo_url"] == "https://example.org/ada/neuralguide"
    footer = (ROOT / "tools/site_theme/partials/copyright.html").read_text("utf-8")
    assert "extra.version" in footer and "repo_url" in footer and "report-a-bug" in footer


#: Pages that are made when the site is built.
MADE = {"install.md", "examples.md", "api.md"}


def test_pages_that_the_site_lists_exist() -> None:
    listed = re.findall(r"[\w/-]+\.md$", (ROOT / "mkdocs.yml").read_text("utf-8"), re.MULTILINE)
    assert len(listed) > 10
    assert [name for name in listed if name not in MADE and not (ROOT / "docs" / name).is_file()] == []
