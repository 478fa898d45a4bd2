# SPDX-License-Identifier: GPL-3.0-or-later
"""Compiles kernels ahead of time: `python tools/kernel_library.py` makes a library for this checkout.

It takes minutes. Every kernel that a first render needs is compiled for a level of processors
(`engine/runtime/kernel_library.py`: LEVELS) and linked into one shared library, with an index beside it.
`tools/build_extension.py` has the same done for the sources of an extension.

It runs on Linux on x86-64, and makes libraries for that. `--for` makes libraries for other systems too, each in a
folder of its own; these cannot be run here, and no zip has them (foreign_library.py). The linker is the system's
compiler `cc`, or `ziglang` from the package index, which others need.
"""

from __future__ import annotations

import argparse
import hashlib
import importlib.util
import json
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import llvmlite.binding as llvm

if __package__:
    from .elf_symbols import read_symbols, with_own_functions
    from .foreign_library import TARGETS, can_link
    from .foreign_library import link as link_foreign
else:
    from elf_symbols import read_symbols, with_own_functions
    from foreign_library import TARGETS, can_link
    from foreign_library import link as link_foreign

ROOT = Path(__file__).resolve().parent.parent
#: What is compiled (`engine/render/precompile.py`): parts of a row at the same time, and each row finds in the cache
#: what those above have compiled.
PARTS = (
    ("tracing", "shaders"), ("guiding", "spectral"), ("spectral_guiding", "passes"), ("media", "motion"),
    ("cache", "learning"), ("fields", "subsurface"),
)  # fmt: skip
#: What each takes on a machine with nothing else to do [s].
SECONDS = {
    "tracing": 26.0, "shaders": 21.0, "guiding": 22.0, "spectral": 18.0, "spectral_guiding": 18.0, "passes": 30.0,
    "media": 20.0, "motion": 2.0, "subsurface": 4.0, "cache": 4.0, "learning": 4.0, "fields": 20.0,
}  # fmt: skip
LEVEL = "x86-64-v3"
#: Blender's name of the platform that libraries can be made on and for.
PLATFORM = "linux-x64"
#: Where a checkout keeps its library.
OUTPUT = ROOT / "engine" / "compiled"

#: A function of each name that jumps to where the table says.
_JUMPS = """
target triple = "{triple}"
@{table} = global [{count} x ptr] zeroinitializer
{code}
"""


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _seconds(row: Sequence[str], workers: int) -> float:
    """Seconds that parts take side by side, where they were measured."""
    each = [SECONDS.get(part, 0.0) for part in row]
    return max(max(each, default=0.0), sum(each) / workers)


def _expectation(row: Sequence[str], workers: int) -> str:
    return f"about {max(_seconds(row, workers), 5.0):.0f} s"


def can_build() -> bool:
    """Whether libraries can be made on this system."""
    return sys.platform == "linux" and platform.machine() == "x86_64"


def linker() -> list[str]:
    """The command that links.

    Raises
    ------
    SystemExit
        If there is none.
    """
    if found := shutil.which("cc"):
        return [found]
    if importlib.util.find_spec("ziglang") is not None:
        return [sys.executable, "-m", "ziglang", "cc"]
    raise SystemExit("there is no linker for kernels: install a C compiler, or `pip install ziglang`")


def make_jumps(names: Sequence[str], table: str, level: str) -> bytes:
    """An object in which each name is a function that jumps to an address out of a table, filled in later."""
    code = []
    for index, name in enumerate(names):
        lines = (
            f".globl {name}", f".hidden {name}", f".type {name},@function", f"{name}:",
            f"jmp *{table}+{8 * index}(%rip)",
        )  # fmt: skip
        code += [f'module asm "{line}"' for line in lines]
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    llvm.initialize_native_asmparser()
    triple = llvm.get_process_triple()
    text = _JUMPS.format(triple=triple, table=table, count=max(len(names), 1), code="\n".join(code))
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=level, reloc="pic", codemodel="small")
    data: bytes = machine.emit_object(llvm.parse_assembly(text))
    return data


def link(objects: Sequence[Path], exported: Iterable[str], table: str, level: str, target: Path) -> list[str]:
    """Link objects, named by their kernels' keys, into a shared library that needs no other.

    Returns
    -------
    list of str
        The names of its table of addresses, in order.
    """
    symbols = [read_symbols(path.read_bytes()) for path in objects]
    defined = frozenset().union(*(one.defined for one in symbols))
    undefined = frozenset().union(*(one.undefined for one in symbols)) - defined
    # Python's own functions and exceptions are there in every process of Python.
    slots = sorted(name for name in undefined if not name.startswith(("Py", "_Py", "_GLOBAL_OFFSET_TABLE_")))
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        jumps, versions, listed = folder / "jumps.o", folder / "exported", folder / "objects"
        jumps.write_bytes(make_jumps(slots, table, level))
        names = "".join(f' "{name}";' for name in sorted({*exported, table}))
        versions.write_text(f"{{ global:{names} local: *; }};", encoding="ascii")
        own = [folder / path.name for path in objects]
        for path, copy in zip(objects, own, strict=True):
            copy.write_bytes(with_own_functions(path.read_bytes(), f"of_{path.stem}"))
        listed.write_text("\n".join(f'"{path}"' for path in [*own, jumps]), encoding="utf-8")
        options = ["-shared", "-nostdlib", "-Wl,-Bsymbolic", "-Wl,-z,noexecstack", "-Wl,-s", "-Wl,--build-id=none"]
        command = [*linker(), *options, f"-Wl,--version-script={versions}", f"@{listed}", "-o", str(target)]
        subprocess.run(command, check=True)
    return slots


def _run(python: str, arguments: Sequence[str], environment: dict[str, str]) -> str:
    """Start `compile_part.py`; returns what it printed.

    Raises
    ------
    SystemExit
        If it failed.
    """
    command = [python, str(Path(__file__).with_name("compile_part.py")), *arguments]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    if done.returncode:
        problem = f"kernels could not be compiled (exit code {done.returncode})"
        raise SystemExit(f"{problem}: {done.stderr[-2000:]}")
    return done.stdout


def build(
    tree: Path, output: Path, *, package: str = "engine", level: str = LEVEL, parts: Sequence[Sequence[str]] = PARTS,
    python: str = sys.executable, processes: int = 0, foreign: Sequence[str] = (),
) -> Path:
    """Compile and link a library; returns its index, which lies beside it.

    Parameters
    ----------
    tree : Path
        Folder that the engine lies in.
    output : Path
        Folder for library and index.
    package : str
        What the engine is called: with dots if its imports are relative to more than itself.
    level : str
        Processors that the library is for, by LLVM's name.
    parts : sequence of sequences of str
        Parts of the kernels, by row.
    python : str
        The Python that it is for, with numba.
    processes : int
        That compile at the same time; 0: as many as there are processors.
    foreign : sequence of str
        Other platforms (`foreign_library.TARGETS`) that libraries are made for, in folders of `output`.
    """
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        objects = folder / "objects"
        objects.mkdir()
        environment = {
            **os.environ, "NEURALGUIDE_KERNEL_CACHE": str(folder / "cache"), "NEURALGUIDE_KERNEL_LIBRARIES": "",
            "NUMBA_CPU_NAME": level, "NUMBA_CPU_FEATURES": "", "PYTHONDONTWRITEBYTECODE": "1",
        }  # fmt: skip
        facts = json.loads(_run(python, [str(tree), package, "facts"], environment))

        def compile_part(part: str) -> str:
            return _run(python, [str(tree), package, part, str(objects)], environment)

        workers = processes or os.cpu_count() or 1
        whole = sum(_seconds(row, workers) for row in parts)
        _say(f"compiling all kernels for {level}: about {max(round(whole / 60.0), 1)} min, more on a busy machine")
        with ThreadPoolExecutor(workers) as pool:
            for number, row in enumerate(parts, 1):
                _say(f"compiling {' and '.join(row)} ({number} of {len(parts)}): {_expectation(row, workers)}")
                started = time.monotonic()
                print(*pool.map(compile_part, row), sep="", end="", file=sys.stderr)
                _say(f"compiled {' and '.join(row)} in {time.monotonic() - started:.0f} s")
        names = [part for row in parts for part in row]
        for platform_name in foreign:
            pack_foreign(objects, facts, names, platform_name, output / platform_name)
        return pack(objects, facts, names, level, output)


def _read_entries(objects: Path) -> tuple[dict[str, Any], set[str]]:
    """What an index says of kernels, by key, and the names in it."""
    entries = {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(objects.glob("*.json"))}
    return entries, {name for *names, _returned in entries.values() for name in names}


def _index_path(output: Path, made_for: dict[str, Any], level: str) -> Path:
    output.mkdir(parents=True, exist_ok=True)
    return output / f"py{made_for['Python'].replace('.', '')}-{level}.index"


def _write_index(index: Path, library: Path, entries: dict[str, Any], header: dict[str, Any]) -> Path:
    body = json.dumps(entries).encode()
    whole = header | {
        "index": hashlib.sha256(body).hexdigest(), "library": hashlib.sha256(library.read_bytes()).hexdigest(),
    }  # fmt: skip
    index.write_bytes(json.dumps(whole).encode() + b"\n" + body)
    print(f"{len(entries)} kernels, {library.stat().st_size / 2**20:.1f} MiB", file=sys.stderr)
    return index


def pack(objects: Path, facts: dict[str, Any], parts: Sequence[str], level: str, output: Path) -> Path:
    """Link a folder of objects and write library and index, with the facts of `compile_part.py`; returns the index."""
    entries, exported = _read_entries(objects)
    index = _index_path(output, facts["made_for"], level)
    library = index.with_suffix(".so")
    slots = link([objects / f"{key}.o" for key in entries], exported, facts["slots_name"], level, library)
    header = {"made_for": facts["made_for"], "level": level, "slots": slots, "pointers": []}
    return _write_index(index, library, entries, header | {"parts": list(parts), "files": facts["files"]})


def pack_foreign(objects: Path, facts: dict[str, Any], parts: Sequence[str], platform_name: str, output: Path) -> Path:
    """As `pack`, for another platform: from LLVM's code that lies beside the objects."""
    target = TARGETS[platform_name]
    entries, exported = _read_entries(objects)
    index = _index_path(output, facts["made_for"], target.processor)
    library = index.with_suffix(target.suffix)
    codes = {key: (objects / f"{key}.bc").read_bytes() for key in entries}
    slots, pointers = link_foreign(codes, exported, facts["slots_name"], target, library)
    header = {"made_for": facts["made_for"] | {"system": target.system}, "level": target.processor, "slots": slots}
    return _write_index(
        index, library, entries, header | {"pointers": pointers, "parts": list(parts), "files": facts["files"]}
    )


def main() -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--level", default=LEVEL, help="processors that the library is for, by LLVM's name")
    parser.add_argument("--output", type=Path, default=OUTPUT)
    parser.add_argument(
        "--for", dest="foreign", action="append", choices=TARGETS, default=[], metavar="PLATFORM",
        help=f"another platform, one of {', '.join(TARGETS)}: takes ziglang, and cannot be tried here",
    )
    arguments = parser.parse_args()
    if not can_build():
        parser.error("libraries are made on Linux on x86-64")
    if arguments.foreign and not can_link():
        parser.error("libraries for other platforms are linked by ziglang: `pip install ziglang`")
    print(build(ROOT, arguments.output, level=arguments.level, foreign=arguments.foreign))
    return 0


if __name__ == "__main__":
    sys.exit(main())
