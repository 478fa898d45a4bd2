# SPDX-License-Identifier: GPL-3.0-or-later
"""Kernels made ahead give what kernels compiled here give, and what does not fit or is broken costs time alone."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from engine.runtime import kernel_library as runtime
from tests.helpers.kernel_trees import LEVEL, call_kernels, make_relative, make_tree
from tools import kernel_library

pytestmark = [
    pytest.mark.skipif(not kernel_library.can_build(), reason="libraries are made on Linux on x86-64"),
    pytest.mark.skipif(bool(runtime.lacking_features(LEVEL)), reason=f"this processor is none of {LEVEL}"),
]
AHEAD, HERE = f"kernels: 5 made ahead for {LEVEL}", "kernels: 5 compiled here"


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Sources of a small engine."""
    return make_tree(tmp_path_factory.mktemp("tree"))


@pytest.fixture(scope="module")
def made(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the library of these sources."""
    folder = tmp_path_factory.mktemp("made")
    kernel_library.build(tree, folder, parts=[["all"]])
    return folder


@pytest.fixture(scope="module")
def expected(tree: Path, tmp_path_factory: pytest.TempPathFactory) -> str:
    """What the kernels give, compiled here for the library's level."""
    results, origins, _ = call_kernels(tree, "", tmp_path_factory.mktemp("cache"), level=LEVEL)
    assert origins == HERE
    return results


@pytest.fixture
def libraries(made: Path, tmp_path: Path) -> Path:
    """A copy of the library, to be broken."""
    return Path(shutil.copytree(made, tmp_path / "libraries"))


def test_results_are_those_of_kernels_compiled_here_bit_for_bit(
    tree: Path, made: Path, expected: str, tmp_path: Path
) -> None:
    cache = tmp_path / "cache"
    assert call_kernels(tree, made, cache) == (expected, AHEAD, "")
    assert list(cache.rglob("*")) == [], "something was compiled, or written in vain"


def test_nothing_is_written_beside_a_library(tree: Path, made: Path, expected: str, tmp_path: Path) -> None:
    """So that the folder of an extension may be read-only."""

    def state() -> list[tuple[str, int]]:
        return sorted((path.name, path.stat().st_mtime_ns) for path in (made, *made.iterdir()))

    before = state()
    assert call_kernels(tree, made, tmp_path / "cache")[0] == expected
    assert state() == before


def test_a_full_disk_does_not_matter(tree: Path, made: Path, expected: str, tmp_path: Path) -> None:
    results, origins, _ = call_kernels(tree, made, tmp_path / "cache", limit=0)
    assert (results, origins) == (expected, AHEAD)
    assert list((tmp_path / "cache").rglob("*")) == [], "something was left behind"


def test_processes_start_at_once(tree: Path, made: Path, expected: str, tmp_path: Path) -> None:
    with ThreadPoolExecutor(3) as pool:
        found = list(pool.map(lambda _: call_kernels(tree, made, tmp_path / "cache"), range(3)))
    assert found == [(expected, AHEAD, "")] * 3


def change_header(folder: Path, change: Callable[[dict[str, object]], None]) -> None:
    """Change what an index says that its library was made for."""
    (index,) = folder.glob("*.index")
    header, _, body = index.read_bytes().partition(b"\n")
    facts = json.loads(header)
    change(facts["made_for"])
    index.write_bytes(json.dumps(facts).encode() + b"\n" + body)


@pytest.mark.parametrize(
    ("what", "value", "problem"),
    [
        ("numba", "0.61.0", "made for numba 0.61.0, and here is"),
        ("Python", "3.9", "made for Python 3.9, and here is"),
    ],
)
def test_what_a_library_was_not_made_for_is_compiled(
    tree: Path, libraries: Path, tmp_path: Path, what: str, value: object, problem: str
) -> None:
    """A `numba` of another version, that another add-on has loaded already, for one."""
    change_header(libraries, lambda made_for: made_for.update({what: value}))
    cache = tmp_path / "cache"
    _, origins, _ = call_kernels(tree, libraries, cache)
    assert origins.startswith(f"{HERE}; those made ahead are not used: py") and problem in origins
    again = call_kernels(tree, libraries, cache)[1]
    assert again.startswith("kernels: 5 from the cache; those made ahead are not used"), "the cache comes next"


def test_a_processor_that_lacks_something_compiles(tree: Path, made: Path, tmp_path: Path) -> None:
    origins = call_kernels(tree, made, tmp_path / "cache", asks_for="quantum")[1]
    assert origins.startswith(HERE) and origins.endswith("this processor has no quantum")


def test_other_sources_compile(made: Path, expected: str, tmp_path: Path) -> None:
    tree = make_tree(tmp_path / "tree")
    worker = tree / "engine" / "render" / "precompile_worker.py"
    worker.write_text(worker.read_text().replace("0.3", "0.4"))
    results, origins, _ = call_kernels(tree, made, tmp_path / "cache", level=LEVEL)
    assert results != expected, "machine code of other sources was used"
    assert origins.startswith(HERE) and "made for sources" in origins


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[: path.stat().st_size // 2])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0xFF
    path.write_bytes(data)


def scribble(path: Path) -> None:
    path.write_bytes(b"\xff\xfe no index, and no library")


@pytest.mark.parametrize(
    ("suffix", "damage"),
    [("so", flip), ("so", Path.unlink), ("index", cut), ("index", scribble)],
    ids=lambda value: getattr(value, "__name__", value),
)
def test_a_damaged_library_is_a_sentence(
    tree: Path, libraries: Path, tmp_path: Path, suffix: str, damage: Callable[[Path], None]
) -> None:
    (path,) = libraries.glob(f"*.{suffix}")
    damage(path)
    origins = call_kernels(tree, libraries, tmp_path / "cache")[1]
    reason = "No such file or directory" if damage is Path.unlink else "damaged"
    assert origins.startswith(f"{HERE}; those made ahead are not used") and reason in origins


def test_an_extension_may_be_called_anything(expected: str, tmp_path: Path) -> None:
    """Blender names packages of extensions after repositories, which users name."""
    tree = make_tree(tmp_path / "some_extension")
    make_relative(tree)
    kernel_library.build(tree, tmp_path / "made", package="another.engine", parts=[["all"]])
    found = call_kernels(tmp_path, tmp_path / "made", tmp_path / "cache", package="some_extension.engine")
    assert found == (expected, AHEAD, "")


def test_types_that_kernels_return_are_read_as_written() -> None:
    from numba import types

    for typ in (types.none, types.int64, types.float32, types.boolean, types.Tuple((types.int64, types.float32))):
        assert runtime.read_type(json.loads(json.dumps(runtime.write_type(typ)))) == typ
    assert runtime.write_type(types.UniTuple(types.float32, 3)) == ["float32"] * 3
    assert runtime.write_type(types.Array(types.float32, 1, "C")) is None
