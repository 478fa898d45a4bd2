# SPDX-License-Identifier: GPL-3.0-or-later
"""A layout that notes what a panel draws into it."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any


class Layout:
    """Notes what a panel draws: owners and names of properties, texts, operators, and choices of menus."""

    def __init__(self) -> None:
        self.drawn: list[tuple[Any, str]] = []
        self.texts: list[str] = []
        self.operators: list[str] = []
        self.popovers: list[str] = []
        self.choices: list[str] = []
        self.active = self.enabled = True

    def prop(self, owner: Any, name: str, **look: Any) -> None:
        getattr(owner, name)
        self.drawn.append((owner, name))
        self.texts.append(look.get("text") or owner.bl_rna.properties[name].name)

    def prop_enum(self, _owner: Any, _name: str, value: str) -> None:
        self.choices.append(value)

    def menu(self, name: str, text: str) -> None:
        import bpy

        self.texts.append(text)
        getattr(bpy.types, name).draw(SimpleNamespace(layout=self), bpy.context)

    def popover(self, panel: str, **_look: Any) -> None:
        self.popovers.append(panel)

    def column(self, heading: str = "", **_look: Any) -> Layout:
        self.texts += [heading] if heading else []
        return self

    row = box = split = column

    def label(self, text: str = "", **_look: Any) -> None:
        self.texts.append(text)

    def template_curve_mapping(self, owner: Any, name: str) -> None:
        self.prop(owner, name)

    def operator(self, name: str, **_look: Any) -> Any:
        self.operators.append(name)
        return SimpleNamespace()

    def operator_menu_enum(self, name: str, _property: str) -> Any:
        return self.operator(name)
