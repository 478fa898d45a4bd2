# SPDX-License-Identifier: GPL-3.0-or-later
"""Names in object files, of one that the tool for libraries makes itself."""

from __future__ import annotations

import pytest

from tools.elf_symbols import read_symbols
from tools.kernel_library import LEVEL, can_build, make_jumps


@pytest.mark.skipif(not can_build(), reason="the object is for Linux on x86-64")
def test_names_are_found() -> None:
    symbols = read_symbols(make_jumps(["sinf", "numba_unpickle"], "table", LEVEL))
    assert symbols.defined == {"sinf", "numba_unpickle", "table"}
    assert symbols.undefined == set()


@pytest.mark.parametrize("data", [b"", b"MZ\x90\x00", b"\x7fELF\x01\x01" + bytes(60)])
def test_other_files_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not an ELF file"):
        read_symbols(data)
