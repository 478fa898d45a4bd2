# SPDX-License-Identifier: GPL-3.0-or-later
"""What MkDocs asks of us while it builds the site (mkdocs.yml).

The page on installing is made of README.md, so that nothing is said twice. Links from docs/ into the rest of the
repository become plain text, since the site holds docs/ alone; tests/test_docs.py checks them. Links that are a file's
name in the repository are a page's title here. Every page says which version it is of, and where the repository is, if
the checkout knows that.
"""

from __future__ import annotations

import os
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

#: README.md's sections that make up the page on installing.
INSTALL_SECTIONS = ("Install it in Blender", "Try it without Blender", "Render without a window", "Limits")

#: Begins a line that goes on with an item of a list, as the repository's pages indent it; MkDocs asks for four spaces.
_ITEM_INDENT = re.compile(r"^ {2,3}(?=[^ \n])", re.MULTILINE)
_TITLE = re.compile(r"^# (.+?)\s*$", re.MULTILINE)
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


def within_install(text: str) -> str:
    """A page's text, links into README.md's sections on installing made to lead to the site's page of them."""
    anchors = "|".join(re.escape(name.lower().replace(" ", "-")) for name in INSTALL_SECTIONS)
    return re.sub(rf"\]\(\.\./README\.md#({anchors})\)", r"](install.md#\1)", text)


def with_titles(text: str, folder: Path) -> str:
    """A page's text, links that show a page's file name made to show its title; `folder` is the page's."""

    def titled(match: re.Match[str]) -> str:
        words, path, anchor = match.group(1), match.group(2), match.group(3) or ""
        file = (folder / path).resolve()
        if not words.strip("`").endswith(".md") or not file.is_file():
            return match.group(0)
        title = _TITLE.search(file.read_text("utf-8"))
        return f"[{title.group(1) if title else words}]({path}{anchor})"

    return _LINK.sub(titled, text)


def repository_address(remote: str) -> str:
    """Address for browsers of a remote as git has it, '' where it has none."""
    form = r"(?:https?://(?:[^@/]+@)?|ssh://git@|git@)([\w.-]+)[:/]([\w./-]+?)(?:\.git)?/?"
    found = re.fullmatch(form, remote.strip())
    return f"https://{found.group(1)}/{found.group(2)}" if found else ""


def _git(*arguments: str) -> str:
    try:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def _repository() -> str:
    """Where the repository is: GitHub's own word where it builds the site, else that of the checkout."""
    server, name = os.environ.get("GITHUB_SERVER_URL"), os.environ.get("GITHUB_REPOSITORY")
    return f"{server}/{name}" if server and name else repository_address(_git("config", "--get", "remote.origin.url"))


def on_config(config: Any) -> Any:
    """Say on every page which version it is of, and where the repository is."""
    manifest = tomllib.loads((ROOT / "blender_manifest.toml").read_text("utf-8"))
    config["extra"] |= {"version": manifest["version"], "commit": _git("rev-parse", "--short", "HEAD")}
    address = _repository()
    if address:
        config["repo_url"], config["repo_name"] = address, "Repository"
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the page on installing."""
    from mkdocs.structure.files import File

    files.append(File.generated(config, "install.md", content=install_page((ROOT / "README.md").read_text("utf-8"))))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Indent lists as MkDocs reads them, and keep links within the site."""
    docs = Path(config["docs_dir"]).resolve()
    markdown = _ITEM_INDENT.sub("    ", markdown)
    folder = (docs / page.file.src_uri).parent
    if folder == docs:
        markdown = within_install(markdown)
    return within_site(with_titles(markdown, folder), folder, docs)
