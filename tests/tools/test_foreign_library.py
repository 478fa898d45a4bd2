# SPDX-License-Identifier: GPL-3.0-or-later
"""Libraries for Windows and macOS are whole, ask for nothing that is not there, and are refused on any other system."""

from __future__ import annotations

import json
from pathlib import Path

import llvmlite.binding as llvm
import pytest

from tests.helpers.kernel_trees import LEVEL, call_kernels, make_tree
from tools import kernel_library
from tools.foreign_library import POINTER, TARGETS, check, translate
from tools.object_symbols import read_library, read_object

each_target = pytest.mark.parametrize("name", TARGETS)

#: A kernel that calls a helper, mathematics, Python, and reads Python's data and the clock.
_CODE = """
target datalayout = "e-m:e-p270:32:32-p271:32:32-p272:64:64-i64:64-i128:128-f80:128-n8:16:32:64-S128"
target triple = "x86_64-unknown-linux-gnu"
@PyExc_TypeError = external global i8
@environment = common global ptr null
declare i32 @PyArg_UnpackTuple(ptr, ptr, i64, i64, ...)
declare float @llvm.pow.f32(float, float)
declare i64 @llvm.readcyclecounter()
define linkonce_odr i32 @helper(ptr %out) {
  %room = alloca [9000 x i8]
  store i64 ptrtoint (ptr @PyExc_TypeError to i64), ptr %out
  %done = call i32 (ptr, ptr, i64, i64, ...) @PyArg_UnpackTuple(ptr %room, ptr %out, i64 1, i64 1, ptr %out)
  ret i32 %done
}
define i32 @entry(ptr %out, float %x) {
  %power = call float @llvm.pow.f32(float %x, float %x)
  store float %power, ptr %out
  %ticks = call i64 @llvm.readcyclecounter()
  store i64 %ticks, ptr %out
  %done = call i32 @helper(ptr %out)
  ret i32 %done
}
"""


@each_target
def test_code_is_compiled_for_the_other_system(name: str) -> None:
    target = TARGETS[name]
    code = llvm.parse_assembly(_CODE).as_bitcode()
    symbols = read_object(translate(code, target, {"entry", "environment"}))
    assert {"entry", "environment"} <= symbols.defined and "helper" not in symbols.defined
    functions = {"PyArg_UnpackTuple", "powf"}
    if target.is_windows:
        # Frames larger than a page are touched page by page there.
        assert symbols.undefined == functions | {f"{POINTER}PyExc_TypeError", "_fltused", "__chkstk"}
    else:
        # Reading the processor's own counter would end the process.
        assert symbols.undefined == functions | {"PyExc_TypeError", "neuralguide_ticks"}


@each_target
def test_a_library_is_whole_and_refused_here(name: str, tmp_path: Path) -> None:
    pytest.importorskip("ziglang")
    if not kernel_library.can_build():
        pytest.skip("libraries are made on Linux on x86-64")
    tree, made = make_tree(tmp_path / "tree"), tmp_path / "made"
    own = kernel_library.build(tree, made, parts=[["all"]], foreign=[name])
    target = TARGETS[name]
    (index,) = (made / name).glob("*.index")
    library = index.with_suffix(target.suffix).read_bytes()
    header, entries = (json.loads(part) for part in index.read_bytes().split(b"\n", 1))
    assert entries == json.loads(own.read_bytes().split(b"\n", 1)[1])
    assert header["made_for"]["system"] == target.system and header["level"] == target.processor
    assert {"Py_DecRef", "sinf", "powf"} <= set(header["slots"])
    assert read_library(library).defined >= {name for *names, _ in entries.values() for name in names}
    with pytest.raises(ValueError, match="lacks no_kernel"):
        check(library, {"no_kernel"})

    # Under the name that this system looks for, it is one more sentence.
    index.rename(index.with_name(f"{index.stem.partition('-')[0]}-{LEVEL}.index"))
    origins = call_kernels(tree, made / name, tmp_path / "cache")[1]
    assert origins.startswith("kernels: 5 compiled here; those made ahead are not used")
    assert f"made for system {target.system}, and here is linux" in origins


def test_what_is_no_such_file_is_refused() -> None:
    for read in (read_library, read_object):
        with pytest.raises(ValueError, match="not "):
            read(b"\x7fELF" + bytes(100))
