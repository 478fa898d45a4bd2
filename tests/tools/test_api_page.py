# SPDX-License-Identifier: GPL-3.0-or-later
"""The site's page of what scripts use has all of it."""

from __future__ import annotations

import ast
import importlib
from pathlib import Path

import pytest

from tools import api_page

ROOT = Path(__file__).resolve().parents[2]
#: What scripts of the examples use besides: the parts that a source's kernels are made of.
FOR_KERNELS = (
    "engine.kernels.", "engine.runtime.", "engine.state.", "engine.array_types", "engine.guiding.sources.guide_kernels",
)  # fmt: skip


def test_all_that_is_listed_is_there_and_has_words() -> None:
    page = api_page.api_page()
    for section in api_page.SECTIONS:
        for module, names in section.names.items():
            for name in names:
                assert hasattr(importlib.import_module(module), name)
                entry = page.split(f"\n### {name}\n")[1].split("\n### ")[0].split("\n## ")[0]
                words = entry.replace(f"`from {module} import {name}`", "")
                assert f"`from {module} import {name}`" in entry and len(words.split()) > 3, name


def test_examples_use_nothing_else() -> None:
    listed = {
        (module, name) for section in api_page.SECTIONS for module, names in section.names.items() for name in names
    }
    used = {
        (node.module, alias.name)
        for script in (ROOT / "examples").glob("*.py")
        for node in ast.walk(ast.parse(script.read_text("utf-8")))
        if isinstance(node, ast.ImportFrom) and node.module and node.module.startswith(("engine.", "addon"))
        for alias in node.names
    }
    assert len(used) > 15
    assert [item for item in sorted(used - listed) if not item[0].startswith(FOR_KERNELS)] == []


SHOP = '''
#: How many
#: there are.
COUNT = 3


class Basket:
    """Holds apples.

    Parameters
    ----------
    apples, pears : int
        How many
        at first.
    """

    size: float = 1.0  # [kg]
    #: Who has it.
    owner: str = ""

    def __init__(self, apples: int, pears: int) -> None:
        pass

    @property
    def weight(self) -> float:
        """Weight of all [kg]."""

    def empty(
        self, *, fast: bool
    ) -> list[str]:
        """Take all out.

        Returns
        -------
        list of str
            What was in it.

        Raises
        ------
        ValueError
            If it is locked.
        """

    def _hidden(self) -> None:
        """Not for scripts."""
'''

SHOP_PAGE = """

Apples.

### COUNT

`from shop import COUNT`

How many there are.

### Basket

`from shop import Basket`

Holds apples.

*Parameters*

- **apples, pears**: int
    <br>How many
    at first.

```python
size: float = 1.0  # [kg]
#: Who has it.
owner: str = ""
```

```python
def __init__(self, apples: int, pears: int) -> None:
```

```python
@property
def weight(self) -> float:
```

Weight of all [kg].

```python
def empty(
    self, *, fast: bool
) -> list[str]:
```

Take all out.

*Returns*

- **list of str**
    <br>What was in it.

*Raises*

- **ValueError**
    <br>If it is locked.
"""


def test_docstrings_become_markdown(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "shop.py").write_text(SHOP, "utf-8")
    monkeypatch.setattr(api_page, "ROOT", tmp_path)
    monkeypatch.setattr(
        api_page, "SECTIONS", (api_page.Section("Buy", "Apples.", {"shop": ("COUNT", "Basket")}),)
    )
    assert api_page.api_page().partition("## Buy")[2] == SHOP_PAGE
    monkeypatch.setattr(api_page, "SECTIONS", (api_page.Section("Buy", "Apples.", {"shop": ("Plum",)}),))
    with pytest.raises(LookupError, match="Plum"):
        api_page.api_page()
