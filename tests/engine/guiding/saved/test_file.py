# SPDX-License-Identifier: GPL-3.0-or-later
"""Files of learned fields: whole or not at all, and each bad one says what is wrong with it and what to do."""

from __future__ import annotations

import io
import json
import os
import threading
import zipfile
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from engine.guiding.saved import file as field_file
from engine.guiding.saved.file import FieldFileError, load_field, save_field
from engine.guiding.saved.learned import LearnedField
from tests.helpers.learned_fields import learned_field

MANIFEST = "neuralguide-field.json"

posix = pytest.mark.skipif(os.name != "posix", reason="no pipes among files")
field = cache(learned_field)


def names_in(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def test_a_field_comes_back_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    assert names_in(tmp_path) == ["room.ngfield"]
    found = load_field(path)
    assert list(found.state) == list(field().state)
    for name, array in field().state.items():
        np.testing.assert_array_equal(found.state[name], array, strict=True)
    assert found.digest == field().digest
    assert found == LearnedField(found.state, *(getattr(field(), name) for name in (
        "light_digest", "rung", "verdict", "efficiency", "samples", "records_per_path", "ray_count", "variance",
        "brightness",
    )))  # fmt: skip


def test_files_are_plain_zips_that_hold_no_code(tmp_path: Path) -> None:
    """Numbers of fixed types, little-endian, that need nothing of ours to be read."""
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    with zipfile.ZipFile(path) as archive:
        manifest = json.loads(archive.read(MANIFEST))
        assert archive.namelist()[0] == MANIFEST
        for name, kind, shape in manifest["arrays"]:
            assert kind in ("<f4", "<f8", "<i4", "<i8", "|u1")
            stored = np.frombuffer(archive.read(f"arrays/{name}"), kind).reshape(shape)
            np.testing.assert_array_equal(stored, field().state[name])
    assert (manifest["format"], manifest["version"]) == ("NeuralGuide learned field", 1)


def rewritten(path: Path, manifest: Callable[[dict[str, Any]], Any] | None = None, **arrays: Any) -> None:
    """Write the file anew with another manifest or other bytes of some arrays (dots are underscores twice)."""
    with zipfile.ZipFile(path) as archive:
        members = {name: archive.read(name) for name in archive.namelist()}
    if manifest is not None:
        members[MANIFEST] = json.dumps(manifest(json.loads(members[MANIFEST]))).encode()
    for name, change in arrays.items():
        member = "arrays/" + name.replace("__", ".")
        members[member] = change(members[member])
    with zipfile.ZipFile(path, "w") as archive:
        for name, data in members.items():
            archive.writestr(name, data)


def changed(kind: str, **cells: Any) -> Callable[[bytes], bytes]:
    """Bytes of an array with its first number replaced."""
    def change(data: bytes) -> bytes:
        array = np.frombuffer(data, kind).copy()
        array[cells.get("at", 0)] = cells["to"]
        return array.tobytes()

    return change


def spoil_newer(path: Path) -> None:
    rewritten(path, lambda manifest: manifest | {"version": 2})


def spoil_cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:-1000])


def spoil_bit(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 0x10
    path.write_bytes(bytes(data))


def spoil_foreign(path: Path) -> None:
    path.write_bytes(b"\x89PNG\r\n\x1a\n" + bytes(1000))


def spoil_foreign_zip(path: Path) -> None:
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("word/document.xml", "<w/>")


def spoil_empty(path: Path) -> None:
    path.write_bytes(b"")


def spoil_missing(path: Path) -> None:
    path.unlink()


def spoil_folder(path: Path) -> None:
    path.unlink()
    path.mkdir()


def spoil_bomb(path: Path) -> None:
    """A small file that unpacks to more than a field can have."""
    buffer = io.BytesIO(path.read_bytes())
    with zipfile.ZipFile(buffer, "a", zipfile.ZIP_DEFLATED) as archive, archive.open("arrays/zeros", "w") as member:
        for _ in range(9):
            member.write(bytes(1 << 26))
    path.write_bytes(buffer.getvalue())


def spoil_nan(path: Path) -> None:
    rewritten(path, mixture__lobes=changed("<f4", to=np.nan))


def spoil_tree(path: Path) -> None:
    rewritten(path, mixture__node_link=changed("<i4", at=1, to=10**6))


def spoil_circle(path: Path) -> None:
    rewritten(path, mixture__node_link=changed("<i4", at=1, to=0))


def spoil_density(path: Path) -> None:
    """Directions would be drawn by other densities than they are weighed by."""
    lobe_rows, lobes = 7, 16
    rewritten(path, mixture__lobes=changed("<f4", at=(lobe_rows - 1) * lobes, to=3.0))


def spoil_probability(path: Path) -> None:
    rewritten(path, selection__probability=changed("<f4", to=1.0))


def spoil_shape(path: Path) -> None:
    rewritten(path, mixture__pivot=lambda data: data[:-4])


def spoil_facts(path: Path) -> None:
    rewritten(path, lambda manifest: manifest | {"facts": manifest["facts"] | {"samples": "many"}})


def spoil_objects(path: Path) -> None:
    """A type that numpy would unpickle."""
    def change(manifest: dict[str, Any]) -> dict[str, Any]:
        manifest["arrays"][0][1] = "|O"
        return manifest

    rewritten(path, change)


def spoil_copies(path: Path) -> None:
    """A small file whose array would be unpacked again and again."""
    rewritten(path, lambda manifest: manifest | {"arrays": 17 * manifest["arrays"][:1] + manifest["arrays"][1:]})


def spoil_manifest(path: Path) -> None:
    rewritten(path, lambda manifest: manifest | {"facts": manifest["facts"] | {"light_digest": "0" * (1 << 20)}})


def spoil_pipe(path: Path) -> None:
    path.unlink()
    os.mkfifo(path)


def spoil_device(path: Path) -> None:
    path.unlink()
    path.symlink_to("/dev/zero")


DAMAGED = "is damaged .*: save a learned field anew"
FOREIGN = "is no learned field of NeuralGuide: choose a file that was made by Save Learned Field"


@pytest.mark.parametrize(("spoil", "message"), [
    (spoil_newer, r"was saved by a newer NeuralGuide \(version 2 of the file, this one reads 1\): update NeuralGuide"),
    (spoil_cut, DAMAGED), (spoil_bit, DAMAGED), (spoil_nan, DAMAGED), (spoil_tree, DAMAGED), (spoil_circle, DAMAGED),
    (spoil_density, DAMAGED), (spoil_probability, DAMAGED), (spoil_shape, DAMAGED), (spoil_facts, DAMAGED),
    (spoil_objects, DAMAGED), (spoil_foreign, FOREIGN), (spoil_foreign_zip, FOREIGN), (spoil_empty, FOREIGN),
    (spoil_missing, "there is no file .*: save a learned field first"), (spoil_folder, "cannot be read .*: choose"),
    (spoil_bomb, "has 5.. MiB, and no learned field more than 512"), (spoil_copies, DAMAGED),
    (spoil_manifest, DAMAGED),
    *[pytest.param(spoil, r"cannot be read \(it is no plain file\): choose", marks=posix)
      for spoil in (spoil_pipe, spoil_device)],
])  # fmt: skip
def test_a_bad_file_says_what_is_wrong_and_what_to_do(
    spoil: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    spoil(path)
    with pytest.raises(FieldFileError, match=message) as raised:
        load_field(path)
    assert str(path) in str(raised.value)


def test_whatever_byte_is_damaged_the_file_says_so(tmp_path: Path) -> None:
    """One bit, all over the file and at each byte of where it says what is where; and files cut short anywhere."""
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    whole = path.read_bytes()
    directory = whole.index(b"PK\x01\x02")
    places = [*range(0, 200), *range(200, directory, directory // 60), *range(directory, len(whole), 3)]
    for number, place in enumerate(places):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << number % 8
        path.write_bytes(damaged)
        with pytest.raises(FieldFileError, match=rf"{DAMAGED}|{FOREIGN}|newer NeuralGuide|more than 512"):
            load_field(path)
    for size in range(0, len(whole), len(whole) // 40):
        path.write_bytes(whole[:size])
        with pytest.raises(FieldFileError, match=f"{DAMAGED}|{FOREIGN}"):
            load_field(path)


def test_files_of_other_programs_need_no_digest_and_are_read_or_refused(tmp_path: Path) -> None:
    """Whatever their directory says, there is a field or a sentence."""
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    rewritten(path, lambda manifest: {name: what for name, what in manifest.items() if name != "is_sealed"})
    assert load_field(path).digest == field().digest
    whole = path.read_bytes()
    refused = 0
    directory = whole.index(b"PK\x01\x02")
    for place in range(directory, len(whole), 5):
        damaged = bytearray(whole)
        damaged[place] ^= 1 << place % 8
        path.write_bytes(damaged)
        try:
            load_field(path)
        except FieldFileError:
            refused += 1
    assert refused > (len(whole) - directory) // 20


#: Arrays of a field that hold floats.
FLOATS = (
    "deltas.estimate", "deltas.position", "light_share.share", "light_share.sums", "max_distance", "mixture.bounds",
    "mixture.lobes", "mixture.moments", "mixture.node_split", "mixture.pivot", "mixture.split_statistics",
    "mixture.statistics", "mixture.totals", "selection.benefit", "selection.probability", "selection.sums",
    "table.sums",
)  # fmt: skip


def test_all_arrays_of_floats_are_listed() -> None:
    assert sorted(name for name, array in field().state.items() if array.dtype.kind == "f") == list(FLOATS)


@pytest.mark.parametrize("name", FLOATS)
def test_absurd_numbers_are_refused(tmp_path: Path, name: str) -> None:
    """Finite, so that whoever looks for NaN finds nothing: what is learned on top of them would be none."""
    path = tmp_path / "room.ngfield"
    array = np.full_like(field().state[name], 1e300 if field().state[name].dtype == np.float64 else 1e38)
    save_field(path, replace(field(), state=field().state | {name: array}))
    with pytest.raises(FieldFileError, match=DAMAGED):
        load_field(path)


@pytest.mark.parametrize("name", ["efficiency", "samples", "records_per_path", "ray_count", "variance", "brightness"])
def test_absurd_facts_are_refused(tmp_path: Path, name: str) -> None:
    save_field(tmp_path / "room.ngfield", replace(field(), **{name: 1e300}))
    with pytest.raises(FieldFileError, match=DAMAGED):
        load_field(tmp_path / "room.ngfield")


@posix
def test_nothing_but_a_file_is_replaced(tmp_path: Path) -> None:
    os.mkfifo(path := tmp_path / "pipe")
    with pytest.raises(FieldFileError, match="no plain file"):
        save_field(path, field())
    assert path.is_fifo()


def test_a_file_larger_than_any_field_is_not_read(tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "disk.img"
    with path.open("wb") as file:
        file.truncate(field_file.MOST_BYTES + 1)
    monkeypatch.setattr(Path, "read_bytes", lambda _path: pytest.fail("it was read"))
    with pytest.raises(FieldFileError, match="more than 512"):
        load_field(path)


def test_a_file_that_cannot_be_written_leaves_the_old_one(tmp_path: Path, monkeypatch: Any) -> None:
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    before = path.read_bytes()

    def fail(*_arguments: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(os, "fsync", fail)
        with pytest.raises(FieldFileError, match=r"room.ngfield cannot be written \(No space left on device\)"):
            save_field(path, field(1))
    assert path.read_bytes() == before and names_in(tmp_path) == ["room.ngfield"]
    with pytest.raises(FieldFileError, match=r"cannot be written .* choose a folder that exists"):
        save_field(tmp_path / "nowhere" / "room.ngfield", field())


def test_a_read_only_file_system_is_named(tmp_path: Path, monkeypatch: Any) -> None:
    """It refuses to remove what is not there, too."""

    def refuse(self: Path, *_arguments: Any, **_named: Any) -> Any:
        raise OSError(30, "Read-only file system", str(self))

    monkeypatch.setattr(Path, "open", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(FieldFileError, match=r"room.ngfield cannot be written \(Read-only file system\)"):
        save_field(tmp_path / "room.ngfield", field())


def test_readers_see_whole_files_while_two_renders_save_to_one(tmp_path: Path) -> None:
    path = tmp_path / "room.ngfield"
    save_field(path, field())
    digests = {field().digest, field(1).digest}
    is_over = threading.Event()
    failures: list[BaseException] = []

    def save(learned: LearnedField) -> None:
        try:
            while not is_over.is_set():
                save_field(path, learned)
        except BaseException as error:
            failures.append(error)

    writers = [threading.Thread(target=save, args=(field(seed),)) for seed in (0, 1)]
    for writer in writers:
        writer.start()
    seen = set()
    try:
        for _ in range(40):
            seen.add(load_field(path).digest)
    finally:
        is_over.set()
        for writer in writers:
            writer.join()
    assert not failures and seen <= digests
    assert names_in(tmp_path) == ["room.ngfield"]
