# SPDX-License-Identifier: GPL-3.0-or-later
"""What MkDocs asks of us while it builds the site (mkdocs.yml).

The page on installing is made of README.md, so that nothing is said twice. Links from docs/ into the rest of the
repository become plain text, since the site holds docs/ alone; tests/test_docs.py checks them.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

#: README.md's sections that make up the page on installing.
INSTALL_SECTIONS = ("Try it", "Install it in Blender", "Render without a window", "Limits")

#: Begins a line that goes on with an item of a list, as the repository's pages indent it; MkDocs asks for four spaces.
_ITEM_INDENT = re.compile(r"^ {2,3}(?=[^ \n])", re.MULTILINE)
_LINK = re.compile(r"(?<!!)\[([^\]\n]*)\]\(([^)#\s]+)(#[^)\s]*)?\)")


def install_page(readme: str) -> str:
    """The page on installing, from the text of README.md."""
    sections = dict(re.findall(r"^## (.+?)\n(.*?)(?=^## |\Z)", readme, re.MULTILINE | re.DOTALL))
    text = "# Install\n" + "".join(f"\n## {name}\n{sections[name]}" for name in INSTALL_SECTIONS)
    return text.replace("](docs/", "](")


def within_site(text: str, folder: Path, docs: Path) -> str:
    """A page's text, its links to files outside of `docs` made plain; `folder` is the page's."""

    def plain(match: re.Match[str]) -> str:
        words, path = match.group(1), match.group(2)
        is_ours = re.match(r"[a-z]+:", path) or (folder / path).resolve().is_relative_to(docs)
        return match.group(0) if is_ours else words

    return _LINK.sub(plain, text)


def on_files(files: Any, config: Any) -> Any:
    """Add the page on installing."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "install.md", content=install_page((ROOT / "README.md").read_text("utf-8"))))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Indent lists as MkDocs reads them, and keep links within the site."""
    docs = Path(config["docs_dir"]).resolve()
    markdown = _ITEM_INDENT.sub("    ", markdown)
    return within_site(markdown, (docs / page.file.src_uri).parent, docs)
