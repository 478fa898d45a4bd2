# SPDX-License-Identifier: GPL-3.0-or-later
"""A learned field as a file: one zip of a manifest and raw arrays, which any program can read.

- `neuralguide-field.json` comes first: what the file is, its version, the facts of `LearnedField`, and name, type and
  shape of each array.
- `arrays/NAME` holds an array's numbers, little-endian, in C order.

A file is written beside its target and then put in its place, so that nobody ever reads a part of one, and of renders
that write to the same place the last one's file is whole. Nothing in a file is executed, and what it says is checked
before anything is made of it.

Our own files end with a digest of all before it, as the zip's comment, and the manifest says so: `is_sealed`. Other
programs need not write one.
"""

from __future__ import annotations

import hashlib
import io
import json
import math
import zipfile
from pathlib import Path
from typing import IO, Any

import numpy as np

from engine.guiding.fields.state import MOST, State, part
from engine.guiding.fields.table import TableModel
from engine.guiding.models.predictors import TablePredictor, check_trained
from engine.guiding.models.regions import RegionModels
from engine.guiding.saved.learned import VERDICTS, LearnedField
from engine.methods import METHODS, TRAINED_PREDICTORS
from engine.runtime.plain_files import read_plain
from engine.runtime.whole_files import write_whole
from engine.settings import RenderSettings

#: Ends names of files.
SUFFIX = ".ngfield"
FORMAT = "NeuralGuide learned field"
#: Version of what the arrays mean. Files of later versions are refused, those of earlier ones are to be read.
VERSION = 1
#: More than any field has, packed or unpacked [bytes].
MOST_BYTES = 1 << 29

_MANIFEST = "neuralguide-field.json"
#: More than a manifest has [bytes].
_MOST_MANIFEST_BYTES = 1 << 20
_FOLDER = "arrays/"
#: Types of numbers, as files have them.
_TYPES = ("<f4", "<f8", "<i4", "<i8", "|u1")
_TEXTS = ("light_digest", "rung", "verdict")
_NUMBERS = ("efficiency", "samples", "records_per_path", "ray_count", "variance", "brightness")
#: Characters of the digest at the end.
_SEAL_SIZE = 64


class FieldFileError(ValueError):
    """A file cannot be read or written; the message names it and says what to do."""


def save_field(path: Path, learned: LearnedField) -> None:
    """Write a field; what was there before stays until the new file is whole.

    Raises
    ------
    FieldFileError
        If it cannot be written; what was there before is still there.
    """
    if path.exists() and not path.is_file():
        raise FieldFileError(f"{path} cannot be written (it is no plain file): choose another name")
    data = packed_field(learned)
    try:
        write_whole(path, lambda file: _write(file, data))
    except OSError as error:
        raise FieldFileError(
            f"{path} cannot be written ({error.strerror or error}): choose a folder that exists, that you may write to"
            " and that has room"
        ) from error


def _write(file: IO[bytes], data: bytes) -> None:
    file.write(data)


def packed_field(learned: LearnedField) -> bytes:
    """What a file of it holds."""
    facts = {name: getattr(learned, name) for name in (*_TEXTS, *_NUMBERS)}
    arrays = {name: array.astype(array.dtype.newbyteorder("<"), copy=False) for name, array in learned.state.items()}
    described = [[name, array.dtype.str, list(array.shape)] for name, array in arrays.items()]
    manifest = {"format": FORMAT, "version": VERSION, "is_sealed": True, "facts": facts, "arrays": described}
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive:
        # Stored, so that the first bytes of a file say what it is.
        archive.writestr(zipfile.ZipInfo(_MANIFEST), json.dumps(manifest, indent=1))
        for name, array in arrays.items():
            archive.writestr(_FOLDER + name, np.ascontiguousarray(array).tobytes())
        archive.comment = bytes(_SEAL_SIZE)
    packed = buffer.getvalue()[:-_SEAL_SIZE]
    return packed + _seal(packed)


def _seal(data: bytes) -> bytes:
    return hashlib.sha256(data).hexdigest().encode()


def load_field(path: Path) -> LearnedField:
    """Read a field.

    Raises
    ------
    FieldFileError
        If there is no file, or it is no field, damaged, of a later version, or too large.
    """
    try:
        size = path.stat().st_size
        if size > MOST_BYTES:
            raise FieldFileError(_too_large(path, size))
        data = read_plain(path, MOST_BYTES)
    except FileNotFoundError:
        raise FieldFileError(f"there is no file {path}: save a learned field first, or leave the path empty") from None
    except OSError as error:
        raise FieldFileError(
            f"{path} cannot be read ({error.strerror or error}): choose a file that you may read"
        ) from error
    is_ours = _MANIFEST.encode() in data[: 2 * len(_MANIFEST) + 30]
    try:
        return unpacked_field(path, data)
    except FieldFileError:
        raise
    except Exception as error:
        # What is damaged may be anything, and so may be what reading it raises.
        if not is_ours:
            raise FieldFileError(
                f"{path} is no learned field of NeuralGuide: choose a file that was made by Save Learned Field"
            ) from error
        raise FieldFileError(
            f"{path} is damaged ({error}): save a learned field anew, to another file if you want to keep this one"
        ) from error


def _too_large(path: Path, size: int) -> str:
    return (
        f"{path} has {size >> 20} MiB, and no learned field more than {MOST_BYTES >> 20}: choose a file that was made"
        " by Save Learned Field"
    )


def unpacked_field(path: Path, data: bytes) -> LearnedField:
    """The field of which a file holds this; what is damaged may raise anything."""
    with zipfile.ZipFile(io.BytesIO(data)) as archive:
        unpacked = sum(entry.file_size for entry in archive.infolist())
        if unpacked > MOST_BYTES:
            raise FieldFileError(_too_large(path, unpacked))
        if archive.getinfo(_MANIFEST).file_size > _MOST_MANIFEST_BYTES:
            raise ValueError("its manifest is too long")
        manifest = json.loads(archive.read(_MANIFEST))
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise ValueError("its manifest is that of something else")
        version = manifest.get("version")
        if not isinstance(version, int) or version < 1:
            raise ValueError(f"its version is {version!r}")
        if version > VERSION:
            raise FieldFileError(
                f"{path} was saved by a newer NeuralGuide (version {version} of the file, this one reads {VERSION}):"
                " update NeuralGuide, or save a learned field by this one"
            )
        if manifest.get("is_sealed") and _seal(data[:-_SEAL_SIZE]) != data[-_SEAL_SIZE:]:
            raise ValueError("its digest is another one")
        # Each is unpacked once, however small the file is.
        names = [name for name, _kind, _shape in manifest["arrays"]]
        if len(set(names)) != len(names):
            raise ValueError("an array is named twice")
        state = {name: _array(archive, name, kind, shape) for name, kind, shape in manifest["arrays"]}
    learned = LearnedField(state, **_facts(manifest["facts"]))
    _check(state)
    return learned


def _array(archive: zipfile.ZipFile, name: Any, kind: Any, shape: Any) -> np.ndarray:
    """An array of the archive, in the machine's byte order."""
    if kind not in _TYPES:
        raise ValueError(f"{name} has numbers of the type {kind!r}")
    if not all(isinstance(size, int) and size >= 0 for size in shape):
        raise ValueError(f"{name} has the shape {shape!r}")
    raw = archive.read(_FOLDER + name)
    if len(raw) != math.prod(shape) * np.dtype(kind).itemsize:
        raise ValueError(f"{name} has {len(raw)} bytes")
    stored = np.frombuffer(raw, kind).reshape(shape)
    return stored.astype(stored.dtype.newbyteorder("="))


def _facts(facts: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `LearnedField`."""
    texts = {name: facts[name] for name in _TEXTS}
    if not all(isinstance(text, str) for text in texts.values()):
        raise ValueError("a text is none")
    if texts["rung"] not in METHODS or texts["verdict"] not in VERDICTS:
        raise ValueError(f"{texts['rung']!r} or {texts['verdict']!r} is unknown")
    numbers = {name: float(facts[name]) for name in _NUMBERS}
    if not all(0.0 <= number <= MOST for number in numbers.values()):
        raise ValueError("a number is negative, or too large")
    return texts | numbers


def _check(state: State) -> None:
    """Raise unless a render can start from these arrays."""
    regions = RegionModels.of_state(state, RenderSettings().guiding_probability)
    table = part(state, TablePredictor.part)
    for channel_count in (3, 4):
        if TableModel.is_state(table, channel_count):
            TableModel.of_state(table, regions.mixture.region_count, channel_count)
    for name, record in TRAINED_PREDICTORS.items():
        if found := part(state, record.part):
            check_trained(name, found)
