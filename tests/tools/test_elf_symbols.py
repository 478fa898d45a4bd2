# SPDX-License-Identifier: GPL-3.0-or-later
"""Names in object files, of one that the tool for libraries makes itself."""

from __future__ import annotations

import llvmlite.binding as llvm
import pytest

from tools.elf_symbols import read_symbols, with_own_functions
from tools.kernel_library import LEVEL, can_build, make_jumps

for_this_system = pytest.mark.skipif(not can_build(), reason="objects are made for Linux on x86-64")

#: A function that others may define as well and one that calls it.
SHARED_FUNCTION = """
target triple = "{triple}"
define linkonce_odr i32 @helper(i32 %x) noinline {{
  ret i32 %x
}}
define i32 @kernel(i32 %x) {{
  %y = call i32 @helper(i32 %x)
  ret i32 %y
}}
"""


@for_this_system
def test_names_are_found() -> None:
    symbols = read_symbols(make_jumps(["sinf", "numba_unpickle"], "table", LEVEL))
    assert symbols.defined == {"sinf", "numba_unpickle", "table"}
    assert symbols.undefined == set()


@for_this_system
def test_functions_that_others_may_define_get_names_of_their_own() -> None:
    make_jumps([], "table", LEVEL)  # readies LLVM
    triple = llvm.get_process_triple()
    module = llvm.parse_assembly(SHARED_FUNCTION.format(triple=triple))
    data = llvm.Target.from_triple(triple).create_target_machine(reloc="pic").emit_object(module)
    assert read_symbols(data).defined == {"helper", "kernel"}
    own = with_own_functions(data, "own")
    assert read_symbols(own).defined == {"own_0", "kernel"}


@pytest.mark.parametrize("data", [b"", b"MZ\x90\x00", b"\x7fELF\x01\x01" + bytes(60)])
def test_other_files_are_refused(data: bytes) -> None:
    with pytest.raises(ValueError, match="not an ELF file"):
        read_symbols(data)
