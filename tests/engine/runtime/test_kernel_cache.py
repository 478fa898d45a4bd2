# SPDX-License-Identifier: GPL-3.0-or-later
"""A kernel cache that cannot be written, or read, costs time and nothing else, and the user is told."""

from __future__ import annotations

import ast
import hashlib
import importlib.util
import os
import pickle
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from types import ModuleType

import pytest

from engine.render import session
from engine.runtime import kernel_cache, sources
from engine.scene.description import Notice
from engine.settings import RenderSettings
from tests.helpers.small_scenes import floor_scene
from tests.helpers.warm_cache import QUICK_MODULES, cache_without

ROOT = Path(__file__).resolve().parents[3]

#: A module with one kernel, called with arguments of two types; prints what became of the cache.
ONE_KERNEL = """
import sys
if {limit} >= 0:
    import resource
    resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))
from engine.runtime import kernel_cache
from engine.runtime.jit import kernel

@kernel
def double(x):
    return x + x

print("results", double(4), double(2.5))
print("hits", sum(double.stats.cache_hits.values()))
print("root", kernel_cache.cache_root())
print("problem", kernel_cache.problem())
print("files", sum(1 for _ in kernel_cache.cache_root().rglob("*.nbc")))
"""


def environment_with(cache: Path) -> dict[str, str]:
    """For a process that writes no byte code: Python itself puts half of it in place where files may not grow."""
    return {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "PYTHONDONTWRITEBYTECODE": "1",
        "NEURALGUIDE_KERNEL_CACHE": str(cache),
    }


def run_kernel(tmp_path: Path, cache: Path, limit: int = -1) -> dict[str, str]:
    """Call the kernel in a process of its own; files may grow to `limit` bytes there, if that is not negative."""
    script = tmp_path / "one_kernel.py"
    script.write_text(ONE_KERNEL.format(limit=limit))
    environment = environment_with(cache)
    done = subprocess.run([sys.executable, str(script)], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    facts = dict(line.partition(" ")[::2] for line in done.stdout.splitlines())
    assert facts["results"] == "8 5.0"
    return facts


def test_a_second_process_finds_what_the_first_saved(tmp_path: Path) -> None:
    cache = tmp_path / "deep" / "cache"
    first, second = run_kernel(tmp_path, cache), run_kernel(tmp_path, cache)
    assert (first["hits"], first["files"], first["problem"]) == ("0", "2", "")
    assert (second["hits"], second["files"], second["problem"]) == ("2", "2", "")


def test_sources_that_were_moved_are_found_again(tmp_path: Path) -> None:
    """Another installation of the same version, or a folder unpacked anew, compiles nothing."""
    for name in ("here", "there"):
        (tmp_path / name).mkdir()
    run_kernel(tmp_path / "here", tmp_path / "cache")
    assert run_kernel(tmp_path / "there", tmp_path / "cache")["hits"] == "2"


def test_processes_that_start_at_once_fill_one_cache(tmp_path: Path) -> None:
    """As two Blenders that are first started together: each has its result, and there is one of each file."""
    script, cache = tmp_path / "one_kernel.py", tmp_path / "cache"
    script.write_text(ONE_KERNEL.format(limit=-1))
    started = [
        subprocess.Popen([sys.executable, str(script)], env=environment_with(cache), stdout=subprocess.PIPE, text=True)
        for _ in range(3)
    ]
    said = [process.communicate()[0] for process in started]
    assert all("results 8 5.0\n" in text and "problem \n" in text for text in said)
    facts = run_kernel(tmp_path, cache)
    assert (facts["hits"], facts["files"], facts["problem"]) == ("2", "2", "")


#: Two processes save as close together as can be: `second` puts its first file in place after `first` has put its own
#: there, and has read what there is before that; then `first` puts the rest in place, if there is any.
IN_TURN = """
import os, sys, time
from pathlib import Path
from engine.runtime.jit import kernel

@kernel
def double(x):
    return x + x

role, marks, plain, count = sys.argv[1], Path(sys.argv[2]), os.replace, 0

def reach(mark):
    (marks / mark).touch()

def wait_for(mark):
    deadline = time.monotonic() + 60.0
    while not (marks / mark).exists():
        assert time.monotonic() < deadline, mark
        time.sleep(0.01)

def replace(*arguments):
    global count
    count += 1
    if role == "first":
        wait_for("second is ready" if count == 1 else "second is done")
    elif count == 1:
        reach("second is ready")
        wait_for("first has one")
    plain(*arguments)
    if role == "first":
        reach("first has one")

if role != "third":
    os.replace = replace
print(*(double(x) for x in ({"first": [4], "second": [2.5], "third": [4, 2.5]}[role])))
reach(f"{role} is done")
print("hits", sum(double.stats.cache_hits.values()))
"""


def test_processes_that_save_at_once_do_not_take_the_same_place(tmp_path: Path) -> None:
    """One found what the other had compiled for arguments of another type, and ran it."""
    script, marks = tmp_path / "in_turn.py", tmp_path / "marks"
    script.write_text(IN_TURN)
    marks.mkdir()

    def start(role: str) -> subprocess.Popen[str]:
        command = [sys.executable, str(script), role, str(marks)]
        return subprocess.Popen(
            command, env=environment_with(tmp_path / "cache"), stdout=subprocess.PIPE, text=True
        )

    both = [start("first"), start("second")]
    assert [one.communicate()[0] for one in both] == ["8\nhits 0\n", "5.0\nhits 0\n"]
    assert start("third").communicate()[0] == "8 5.0\nhits 2\n"


def test_an_older_version_finds_its_own_kernels_after_a_newer_one(tmp_path: Path) -> None:
    """An upgrade and a downgrade over one user folder: neither takes what the other has compiled."""
    cache = tmp_path / "cache"
    run_kernel(tmp_path, cache)
    script = tmp_path / "one_kernel.py"
    script.write_text(ONE_KERNEL.format(limit=-1).replace("return x + x", "return x + x + x - x"))
    newer = subprocess.run(
        [sys.executable, str(script)], env=environment_with(cache), capture_output=True, text=True, check=True
    )
    assert "results 8 5.0" in newer.stdout and "hits 0" in newer.stdout
    assert run_kernel(tmp_path, cache)["hits"] == "2"


#: Another program, such as one that looks for viruses, holds files open: they can be neither read nor put in place.
LOCKED = {
    "writing": """
import os
def locked(*_arguments):
    raise PermissionError(13, "The process cannot access the file because it is being used by another process")
os.replace = os.rename = locked
""",
    "reading": """
import builtins
plain = builtins.open
def locked(file, mode="r", *arguments, **named):
    if str(file).endswith(".nbc") and "w" not in mode:
        raise PermissionError(13, "The process cannot access the file because it is being used by another process")
    return plain(file, mode, *arguments, **named)
builtins.open = locked
""",
}


@pytest.mark.parametrize("way", LOCKED)
def test_files_that_are_locked_cost_time_alone(tmp_path: Path, way: str) -> None:
    cache, script = tmp_path / "cache", tmp_path / "one_kernel.py"
    if way == "reading":
        run_kernel(tmp_path, cache)
    script.write_text(LOCKED[way] + ONE_KERNEL.format(limit=-1))
    done = subprocess.run(
        [sys.executable, str(script)], env=environment_with(cache), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0 and "results 8 5.0" in done.stdout, done.stderr
    assert "hits 0" in done.stdout
    if way == "writing":
        assert f"problem cannot save to {cache}" in done.stdout
        assert [path.name for path in cache.rglob("*") if path.is_file()] == []


def test_nothing_is_written_beside_the_sources(tmp_path: Path) -> None:
    """So a folder that cannot be written to, as extensions of a whole office have it, does not matter."""
    shutil.copytree(ROOT / "engine", tmp_path / "engine", ignore=shutil.ignore_patterns("__pycache__", "compiled"))
    before = sorted(tmp_path.rglob("engine/**/*"))
    environment = {**environment_with(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    (tmp_path / "one_kernel.py").write_text(ONE_KERNEL.format(limit=-1))
    command = [sys.executable, str(tmp_path / "one_kernel.py")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert "results 8 5.0" in done.stdout, done.stderr
    assert sorted(tmp_path.rglob("engine/**/*")) == before


def test_a_temporary_folder_stands_in_for_one_that_cannot_be_written(tmp_path: Path) -> None:
    """A file where a folder should be stops even root."""
    (tmp_path / "file").write_text("no folder")
    facts = run_kernel(tmp_path, tmp_path / "file" / "cache")
    assert facts["problem"] == f"cannot write to {tmp_path / 'file' / 'cache'} (Not a directory)"
    assert facts["root"].startswith(str(Path(tempfile.gettempdir()) / "neuralguide-kernels-"))
    assert facts["files"] == "2"
    assert not Path(facts["root"]).exists(), "it goes with the process"


@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
def test_kernels_stay_in_memory_where_the_disk_is_full(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    facts = run_kernel(tmp_path, cache, limit=100)
    assert facts["problem"] == f"cannot save to {cache} (File too large)"
    assert facts["files"] == "0"
    again = run_kernel(tmp_path, cache)
    assert (again["hits"], again["files"], again["problem"]) == ("0", "2", "")


def test_damaged_files_count_as_missing(tmp_path: Path) -> None:
    cache = tmp_path / "cache"
    run_kernel(tmp_path, cache)
    for file in cache.rglob("*.nbc"):
        file.write_bytes(file.read_bytes()[:40])
    assert run_kernel(tmp_path, cache)["problem"] == ""
    assert run_kernel(tmp_path, cache)["hits"] == "2"


@pytest.mark.parametrize("place", [0.02, 0.6])
def test_kernels_with_one_bit_wrong_are_compiled_again(tmp_path: Path, place: float) -> None:
    """Run, they would end the process."""
    cache = tmp_path / "cache"
    run_kernel(tmp_path, cache)
    for file in cache.rglob("*.nbc"):
        damaged = bytearray(file.read_bytes())
        damaged[int(place * len(damaged))] ^= 4
        file.write_bytes(damaged)
    again = run_kernel(tmp_path, cache)
    assert (again["hits"], again["problem"]) == ("0", "")
    assert run_kernel(tmp_path, cache)["hits"] == "2"


@pytest.mark.skipif(os.name != "posix", reason="rights of another kind")
def test_what_others_have_put_into_the_cache_is_not_run(tmp_path: Path) -> None:
    """Files of the right names, with digests that are right, in a folder for all."""
    cache, mark = tmp_path / "cache", tmp_path / "was run"
    run_kernel(tmp_path, cache)

    class Planted:
        def __reduce__(self) -> tuple[object, tuple[Path]]:
            return Path.touch, (mark,)

    body = pickle.dumps(Planted())
    for file in cache.rglob("*.nbc"):
        file.write_bytes(hashlib.sha256(body).digest() + body)
    assert run_kernel(tmp_path, cache)["hits"] == "0" and mark.exists(), "else this test proves nothing"
    mark.unlink()
    for file in cache.rglob("*.nbc"):
        file.write_bytes(hashlib.sha256(body).digest() + body)
    cache.chmod(0o1777)
    facts = run_kernel(tmp_path, cache)
    assert not mark.exists() and facts["files"] == "2"
    assert facts["problem"] == f"cannot use {cache}: {cache} can be written by others"
    assert facts["root"].startswith(str(Path(tempfile.gettempdir()) / "neuralguide-kernels-"))
    cache.chmod(0o755)
    for file in cache.rglob("*.nbc"):
        file.chmod(0o666)
    assert run_kernel(tmp_path, cache)["hits"] == "0" and not mark.exists()
    assert run_kernel(tmp_path, cache)["hits"] == "2"


@pytest.fixture
def fresh() -> ModuleType:
    """A copy of the module in which nothing has gone wrong yet."""
    spec = importlib.util.spec_from_file_location("fresh_kernel_cache", kernel_cache.__file__)
    assert spec is not None and spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def root_of(module: ModuleType, chosen: Path) -> Path:
    """Where a module keeps kernels that is asked for the folder `chosen`."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("NEURALGUIDE_KERNEL_CACHE", str(chosen))
        return module.cache_root()


def test_a_read_only_folder_that_is_filled_is_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: ModuleType
) -> None:
    def refuse(**_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    (tmp_path / "tracing-0123.complete").touch()
    assert root_of(fresh, tmp_path) == tmp_path
    assert fresh.problem() == ""
    empty = tmp_path / "empty"
    assert root_of(fresh, empty) != empty
    assert fresh.problem() == f"cannot write to {empty} (Permission denied)"


def test_without_a_home_nobody_can_know_the_folder_before(monkeypatch: pytest.MonkeyPatch, fresh: ModuleType) -> None:
    def nobody() -> Path:
        raise RuntimeError("Could not determine home directory.")

    for name in ("NEURALGUIDE_KERNEL_CACHE", "XDG_CACHE_HOME", "LOCALAPPDATA"):
        monkeypatch.setenv(name, "")
    monkeypatch.setattr(Path, "home", nobody)
    root = fresh.cache_root()
    assert root == fresh.cache_root() and root.name.startswith("neuralguide-kernels-")
    assert "no home folder" in fresh.problem() and "NEURALGUIDE_KERNEL_CACHE" in fresh.problem()
    assert os.environ["NEURALGUIDE_KERNEL_CACHE"] == str(root), "processes that are started use it too"
    assert os.name != "posix" or root.stat().st_mode & 0o777 == 0o700


def test_without_any_writable_folder_nothing_is_raised(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fresh: ModuleType
) -> None:
    def refuse(*_arguments: object, **_options: object) -> None:
        raise OSError(30, "Read-only file system")

    monkeypatch.setattr(tempfile, "TemporaryFile", refuse)
    monkeypatch.setattr(tempfile, "mkdtemp", refuse)
    assert root_of(fresh, tmp_path) == tmp_path
    assert "Read-only file system" in fresh.problem()


def is_of_the_engine(module: str) -> bool:
    """Whether a name is that of a module or package of the engine, not of something within one."""
    path = ROOT.joinpath(*module.split("."))
    return module.split(".")[0] == "engine" and (path.with_suffix(".py").is_file() or (path / "__init__.py").is_file())


def test_imports_are_those_that_the_parser_finds() -> None:
    """An import that goes unseen would leave stale machine code in use."""
    count = 0
    for file in (ROOT / "engine").rglob("*.py"):
        name = ".".join(file.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__")
        package = name if file.name == "__init__.py" else name.rpartition(".")[0]
        expected: set[str] = set()
        for node in ast.walk(ast.parse(file.read_bytes())):
            if isinstance(node, ast.Import):
                expected.update(alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                base = importlib.util.resolve_name("." * node.level + (node.module or ""), package)
                expected.update((base, *(f"{base}.{alias.name}" for alias in node.names)))
            elif isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "FOUND_BY_NAME":
                # All modules of a package count where they are looked up by name.
                for given in ast.literal_eval(node.value):
                    base = importlib.util.resolve_name(given, package)
                    folder = ROOT.joinpath(*base.split("."))
                    expected.update(f"{base}.{module.stem}" for module in folder.glob("*.py") if module != file)
        found = sources.imported_modules(name, file)
        assert found == {module for module in expected if is_of_the_engine(module)}, name
        count += len(found)
    assert count > 300
    assert "engine.guiding.sources.sdtree" in sources.imported_modules(
        "engine.guiding.sources", ROOT / "engine" / "guiding" / "sources" / "__init__.py"
    )


def test_the_user_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def notices() -> list[Notice]:
        loaded = session.Session(RenderSettings(threads=1))
        found = loaded.load(floor_scene())
        loaded.close()
        return [notice for notice in found if notice.subject == "Kernel cache"]

    problem = "cannot save to X (No space left on device)"
    monkeypatch.setattr(session, "cache_problem", lambda: problem)
    assert notices() == [Notice("Kernel cache", problem, "the next process compiles the kernels again")]
    monkeypatch.setattr(session, "cache_problem", lambda: "")
    assert notices() == []


#: Loads a scene where no file may grow beyond a size; prints the notices.
LOAD = """
import resource
resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, resource.RLIM_INFINITY))
from engine.render import precompile
from engine.render.precompile_worker import small_scene
from engine.render.session import Session
from engine.settings import RenderSettings
session = Session(RenderSettings(samples=2, threads=2))
session.load(small_scene())
result = session.render()
assert result.passes["Combined"].mean() > 0.0
for notice in result.report.notices:
    print(notice.subject, notice.problem)
"""


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="no limit on the size of files")
def test_a_render_on_a_full_disk_goes_on_and_says_so(tmp_path: Path) -> None:
    """Helpers give up at once, and this process compiles. A folder that is none is tested by a kernel."""
    full = cache_without(tmp_path / "full", QUICK_MODULES)
    there = sorted(full.rglob("*.nbc"))
    command = [sys.executable, "-c", LOAD.format(limit=100)]
    done = subprocess.run(command, env=environment_with(full), capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert f"Kernel cache cannot save to {full}" in done.stdout
    assert sorted(full.rglob("*.nbc")) == there
    assert not list(full.glob("tracing-*.complete")), "a helper that could not save says that it has"
