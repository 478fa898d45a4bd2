# SPDX-License-Identifier: GPL-3.0-or-later
"""Names of passes that a scene's own names or levels are part of."""

from __future__ import annotations

#: Kinds of Cryptomatte: what their passes' names begin with.
MATTE_KINDS = ("CryptoObject", "CryptoMaterial", "CryptoAsset")
#: Pairs of id and weight in a pass.
PAIRS = 2


def aov_pass(name: str) -> str:
    """The engine's name of the pass of an AOV, which no other pass has."""
    return f"AOV {name}"


def matte_passes(kind: str, levels: int) -> list[str]:
    """Names of the passes that hold so many levels of a kind of Cryptomatte, two in each."""
    return [f"{kind}{index:02}" for index in range((levels + PAIRS - 1) // PAIRS)]
