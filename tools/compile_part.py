# SPDX-License-Identifier: GPL-3.0-or-later
"""What `tools/kernel_library.py` starts: compiles one part of the kernels for a library, into a folder of objects.

    python tools/compile_part.py TREE PACKAGE PART OBJECTS
    python tools/compile_part.py TREE PACKAGE facts

TREE holds the sources, PACKAGE is what the engine is called there. Each kernel becomes three files named by its key:
its object, LLVM's code of it for other systems, and what the index is to say of it. Which processors they are for says
numba's NUMBA_CPU_NAME. `facts` prints what the library is made for.
"""

from __future__ import annotations

import importlib
import json
import sys
import types
from pathlib import Path
from typing import Any

from numba.core.codegen import JITCPUCodegen


def make_linkable() -> None:
    """Have numba compile code that can lie anywhere, as a shared library must; else it is the same."""
    customize = JITCPUCodegen._customize_tm_options

    def customize_for_library(codegen: Any, options: dict[str, Any]) -> None:
        customize(codegen, options)
        options["reloc"], options["codemodel"] = "pic", "small"

    JITCPUCodegen._customize_tm_options = customize_for_library


def stand_in_for_parents(package: str, tree: Path) -> None:
    """Packages that the engine lies in, without what they would import."""
    parents = package.split(".")[:-1]
    for depth in range(1, len(parents) + 1):
        module = types.ModuleType(".".join(parents[:depth]))
        module.__path__ = [str(tree)] if depth == len(parents) else []
        sys.modules[module.__name__] = module


def has_function(module: Any, name: str) -> bool:
    """Whether LLVM's code has a function."""
    try:
        return not module.get_function(name).is_declaration
    except NameError:
        return False


def compile_part(package: str, part: str, objects: Path) -> None:
    """Compile a part and write what comes of it."""
    make_linkable()
    kernel_cache = importlib.import_module(f"{package}.runtime.kernel_cache")
    write_type = importlib.import_module(f"{package}.runtime.kernel_library").write_type

    def keep(key: str, compiled: Any) -> None:
        described, returned = compiled.fndesc, write_type(compiled.signature.return_type)
        environments = (compiled.environment, *compiled._find_referenced_environments())
        if returned is None or any(environment.consts for environment in environments):
            print(f"left out: {described.qualname} -> {compiled.signature.return_type}", flush=True)
            return
        names = [described.llvm_func_name, described.llvm_cpython_wrapper_name, described.env_name]
        if has_function(compiled.library._final_module, described.llvm_cfunc_wrapper_name):
            names.append(described.llvm_cfunc_wrapper_name)
        (objects / f"{key}.o").write_bytes(compiled.library._get_compiled_object())
        (objects / f"{key}.bc").write_bytes(compiled.library._final_module.as_bitcode())
        (objects / f"{key}.json").write_text(json.dumps([*names, returned]), encoding="utf-8")

    kernel_cache.on_compiled = keep
    importlib.import_module(f"{package}.render.precompile_worker").compile_part(part)


def say_what_for(package: str) -> None:
    """Print what a library of this package is made for."""
    library = importlib.import_module(f"{package}.runtime.kernel_library")
    files = library.source_files()
    print(json.dumps({"made_for": library.made_for(files), "files": files, "slots_name": library.SLOTS}))


if __name__ == "__main__":
    _tree, _package, _part, *_objects = sys.argv[1:]
    sys.path.insert(0, _tree)
    stand_in_for_parents(_package, Path(_tree))
    if _objects:
        compile_part(_package, _part, Path(_objects[0]))
    else:
        say_what_for(_package)
