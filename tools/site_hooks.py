# SPDX-License-Identifier: GPL-3.0-or-later
"""What MkDocs asks of us while it builds the site (mkdocs.yml).

Three pages are made here, so that nothing is said twice: that on installing of README.md, that of examples of
examples/README.md and the scripts beside it, and that of what scripts use of docstrings (tools/api_page.py). Links from
docs/ into the rest of the repository become plain text, since the site holds docs/ alone; tests/test_docs.py checks
them. Links that are a file's name in the repository are a page's title here. Every page says which version it is of,
and where the repository is, if the checkout knows that.
"""

from __future__ import annotations

import importlib.util
import os
import re
import subprocess
import tomllib
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]

EXAMPLES = ROOT / "examples"

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


def examples_page(folder: Path) -> str:
    """The page of examples: that of the repository, and then the scripts that it names, in its order."""
    text = (folder / "README.md").read_text("utf-8")
    parts = [text]
    for name in dict.fromkeys(re.findall(r"\]\((\w+\.py)\)", text)):
        parts.append(f"\n## {name}\n\n```python\n{(folder / name).read_text('utf-8').rstrip()}\n```\n")
    # Its links are to files; here a script is a section.
    return re.sub(r"\]\((\w+)\.py\)", r"](#\1py)", "".join(parts))


def api_page() -> str:
    """The page of what scripts use. This file is run by its path, so what lies beside it is found by that."""
    spec = importlib.util.spec_from_file_location("api_page", Path(__file__).with_name("api_page.py"))
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return str(module.api_page())


def within_site(text: str, folder: Path, docs: Path) -> str:
    """A page's text, its links to files outside of `docs` made plain; `folder` is the page's."""

    def plain(match: re.Match[str]) -> str:
        words, path = match.group(1), match.group(2)
        is_ours = re.match(r"[a-z]+:", path) or (folder / path).resolve().is_relative_to(docs)
        return match.group(0) if is_ours else words

    return _LINK.sub(plain, text)


def within_made_pages(text: str) -> str:
    """A page's text, links to what the site has a page of made to lead there: installing, and the examples."""
    text = text.replace("](../examples/README.md)", "](examples.md)")
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
    """Add the pages that are made here."""
    from mkdocs.structure.files import File

    pages = {
        "install.md": install_page((ROOT / "README.md").read_text("utf-8")),
        "examples.md": examples_page(EXAMPLES),
        "api.md": api_page(),
    }
    for name, text in pages.items():
        files.append(File.generated(config, name, content=text))
    return files


def on_page_markdown(markdown: str, page: Any, config: Any, files: Any) -> str:
    """Indent lists as MkDocs reads them, and keep links within the site."""
    docs = Path(config["docs_dir"]).resolve()
    markdown = _ITEM_INDENT.sub("    ", markdown)
    folder = (docs / page.file.src_uri).parent
    if folder == docs:
        markdown = within_made_pages(markdown)
    return within_site(with_titles(markdown, folder), folder, docs)
