# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries of kernels for Windows and macOS, made of the code that numba compiles on Linux; not run on either.

LLVM's code of a kernel names its system in two lines only, and all that kernels call takes numbers and addresses. So it
is compiled once more for another system, and `ziglang` links it. What was found in the way is in
docs/decisions/kernels-ahead-of-time.md. `check` looks at the file, since it cannot be run here.
"""

from __future__ import annotations

import importlib.util
import re
import subprocess
import sys
import tempfile
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import llvmlite.binding as llvm

if __package__:
    from .object_symbols import read_library, read_object
else:
    from object_symbols import read_library, read_object

#: What a pointer to Python's data is called on Windows: before the data's name.
POINTER = "__imp_"
#: Stands for LLVM's own instruction, which only systems may use on ARM; `engine/kernels/clock.py` reads another there.
_TICKS = "neuralguide_ticks"
#: What the libraries have themselves.
_OWN = frozenset({"_fltused", "__chkstk", "__dso_handle", "_mh_dylib_header", _TICKS})


@dataclass(frozen=True)
class Target:
    """A system that libraries are made for.

    triple, processor : as LLVM names them; the processor is the library's level
    linked_for : as zig names the system
    suffix : of libraries
    system : as `engine.runtime.kernel_library.made_for` words it there
    """

    triple: str
    processor: str
    linked_for: str
    suffix: str
    system: str

    @property
    def is_windows(self) -> bool:
        """Whether the system is Windows."""
        return self.suffix == ".dll"


#: By Blender's name of the platform. For Windows code is made as for Microsoft's run-time library, which numba finds
#: functions in there: another has more of them.
TARGETS = {
    "windows-x64": Target("x86_64-pc-windows-msvc", "x86-64-v3", "x86_64-windows-gnu", ".dll", "win32 on AMD64"),
    "macos-arm64": Target("arm64-apple-macosx11.0.0", "apple-m1", "aarch64-macos.11.0", ".dylib", "darwin on arm64"),
}


def can_link() -> bool:
    """Whether `ziglang` is here."""
    return importlib.util.find_spec("ziglang") is not None


def translate(code: bytes, target: Target, exported: Collection[str]) -> bytes:
    """An object for another system.

    Parameters
    ----------
    code : bytes
        LLVM's bitcode of a kernel, as compiled for Linux on x86-64.
    target : Target
    exported : collection of str
        What the library is to have of it; all else is the kernel's own.
    """
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    machine = llvm.Target.from_triple(target.triple).create_target_machine(
        cpu=target.processor, reloc="pic", codemodel="small", opt=3
    )
    text = str(llvm.parse_bitcode(code))
    text = re.sub("^target triple = .*$", f'target triple = "{target.triple}"', text, flags=re.MULTILINE)
    layout = f'target datalayout = "{machine.target_data}"'
    text = re.sub("^target datalayout = .*$", layout, text, flags=re.MULTILINE)
    if target.is_windows:
        # Data of another library are read by way of a pointer, which the loader fills in.
        text = re.sub(r"^(@[\w.$]+ = )external ", r"\1external dllimport ", text, flags=re.MULTILINE)
    else:
        text = text.replace("@llvm.readcyclecounter", f"@{_TICKS}")
    module = llvm.parse_assembly(text)
    for value in (*module.functions, *module.global_variables):
        if not value.is_declaration:
            value.linkage = "external" if value.name in exported else "internal"
    data: bytes = machine.emit_object(module)
    return data


def _jumps(target: Target, table: str, slots: Sequence[str], pointers: Sequence[str]) -> str:
    """Assembly: the table, a function of each name that jumps to where it says, and what code asks of its system."""
    size = 8 * max(len(slots), 1)
    if target.is_windows:
        lines = [".bss", ".p2align 3", f".globl {table}", f"{table}:", f".zero {size}"]
        for name in pointers:
            lines += [f".globl {POINTER}{name}", f"{POINTER}{name}:", ".zero 8"]
        lines += [".data", ".globl _fltused", "_fltused:", ".long 1", ".text"]
        for index, name in enumerate(slots):
            lines += [f".globl {name}", f"{name}:", f"jmp *{table}+{8 * index}(%rip)"]
        # The library's entry says that it is ready. Large frames are touched page by page, RAX bytes of them.
        lines += [
            ".globl DllMainCRTStartup", "DllMainCRTStartup:", "movl $1, %eax", "retq",
            ".globl __chkstk", "__chkstk:", "pushq %rcx", "pushq %rax", "leaq 24(%rsp), %rcx",
            "1:", "cmpq $0x1000, %rax", "jb 2f", "subq $0x1000, %rcx", "orq $0, (%rcx)", "subq $0x1000, %rax", "jmp 1b",
            "2:", "subq %rax, %rcx", "orq $0, (%rcx)", "popq %rax", "popq %rcx", "retq",
        ]  # fmt: skip
    else:
        lines = [".section __DATA,__bss", ".p2align 3", f".globl _{table}", f"_{table}:", f".zero {size}"]
        lines += [".text", ".p2align 2"]
        for index, name in enumerate(slots):
            lines += [
                f".globl _{name}", f".private_extern _{name}", f"_{name}:", f"adrp x16, _{table}@PAGE",
                f"add x16, x16, _{table}@PAGEOFF", f"ldr x16, [x16, #{8 * index}]", "br x16",
            ]  # fmt: skip
        lines += [f".globl _{_TICKS}", f".private_extern _{_TICKS}", f"_{_TICKS}:", "mrs x0, cntvct_el0", "ret"]
    return "\n".join([*lines, ""])


def link(
    codes: Mapping[str, bytes], exported: Collection[str], table: str, target: Target, output: Path
) -> tuple[list[str], list[str]]:
    """Make a library of kernels' bitcode by key; it is checked.

    Returns
    -------
    slots, pointers : list of str
        Names of its table of addresses, in order, and of Python's data that it has pointers for.

    Raises
    ------
    ValueError
        If the library is not what it should be.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        undefined: set[str] = set()
        objects = []
        for key, code in codes.items():
            objects.append(folder / f"{key}.o")
            objects[-1].write_bytes(translate(code, target, exported))
            undefined |= read_object(objects[-1].read_bytes()).undefined
        pointers = sorted(one.removeprefix(POINTER) for one in undefined if one.startswith(POINTER))
        # Functions of Python's come by the table as well: Windows has no names without a library that they are in.
        slots = sorted(
            one for one in undefined - _OWN if not one.startswith((POINTER, "PyExc_", "_Py_"))
        )
        jumps, listed = folder / "jumps.s", folder / "objects"
        jumps.write_text(_jumps(target, table, slots, pointers), encoding="ascii")
        listed.write_text("\n".join(f'"{path}"' for path in [*objects, jumps]), encoding="utf-8")
        if target.is_windows:
            names = folder / "names.def"
            data = [f"{one} DATA" for one in (table, *(POINTER + one for one in pointers))]
            names.write_text("\n".join(["EXPORTS", *sorted(exported), *data, ""]), encoding="ascii")
            options = ["-shared", "-nostdlib", "-Wl,-s", str(names)]
        else:
            options = ["-dynamiclib", "-nostdlib", "-undefined", "dynamic_lookup"]
        made = folder / f"library{target.suffix}"
        command = [sys.executable, "-m", "ziglang", "cc", "-target", target.linked_for, *options, f"@{listed}"]
        subprocess.run([*command, "-o", str(made)], check=True)
        check(made.read_bytes(), {*exported, table, *(POINTER + one for one in pointers)})
        output.write_bytes(made.read_bytes())
    return slots, pointers


def check(library: bytes, needed: Collection[str]) -> None:
    """See whether a library has all that it should, and asks for nothing but Python's data.

    Raises
    ------
    ValueError
        If not.
    """
    symbols = read_library(library)
    if missing := sorted(set(needed) - symbols.defined):
        raise ValueError(f"the library lacks {', '.join(missing)}")
    # The last is of macOS's loader.
    foreign = {one for one in symbols.undefined if not one.startswith(("PyExc_", "_Py_"))} - {"dyld_stub_binder"}
    if foreign:
        raise ValueError(f"the library asks for {', '.join(sorted(foreign))}")
