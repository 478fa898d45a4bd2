# SPDX-License-Identifier: GPL-3.0-or-later
"""A checkpoint as a file: one zip of a manifest and raw arrays, which any program can read.

- `neuralguide-checkpoint.json` comes first: what the file is, its version, what the film is a film of, how far it has
  come, and name, type and shape of each array.
- `learned.ngfield` is what was learned, as a file of its own would hold it (`engine.guiding.saved.file`).
- `arrays/NAME` holds an array's numbers, little-endian, in C order: those of the film's columns, of its strata's, and
  of the schedule.

Nothing in a file is executed. What it says is checked before a render goes on from it, and each array by its CRC-32.
"""

from __future__ import annotations

import json
import math
import zipfile
from collections.abc import Callable, Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import IO, Any

import numpy as np

from engine.guiding.saved.file import MOST_BYTES, packed_field, unpacked_field
from engine.guiding.saved.learned import LearnedField
from engine.render.checkpoint import Checkpoint, Identity
from engine.render.film import Film
from engine.render.loop_state import LooksState, LoopState
from engine.runtime.plain_files import open_at_once
from engine.runtime.whole_files import write_whole
from engine.settings import MAX_SEED
from engine.state.film import FilmTile

FORMAT = "NeuralGuide checkpoint"
#: Of the file itself. What is in it goes by the version of the engine (`Identity`).
VERSION = 1

_MANIFEST = "neuralguide-checkpoint.json"
#: More than a manifest has [bytes].
_MOST_MANIFEST_BYTES = 1 << 20
_FOLDER = "arrays/"
_LEARNED = "learned.ngfield"
#: Read and written at a time [bytes].
_AT_ONCE = 1 << 22


class CheckpointError(ValueError):
    """A checkpoint cannot be read; the message says what is wrong with it, as of the file that is named."""


def save_checkpoint(
    path: Path, checkpoint: Checkpoint, sums: dict[str, FilmTile], on_open: Callable[[int], None] | None = None
) -> None:
    """Write a checkpoint; what was there before stays until all of the new one is on the disk.

    Parameters
    ----------
    path : Path
    checkpoint : Checkpoint
    sums : dict of FilmTile
        As of `sums_of`, which nobody changes meanwhile.
    on_open : callable (int) -> None, optional
        Is told the descriptor of the new file, before it has the name.

    Raises
    ------
    OSError
        If it cannot be written; what was there before is still there.
    """
    state = checkpoint.state
    arrays: dict[str, np.ndarray] = {"ends": state.ends, "is_active": state.looks.is_active.astype(np.uint8)}
    arrays |= {f"{part}.{name}": values for part, tile in sums.items() for name, values in tile._asdict().items()}
    arrays = {name: np.ascontiguousarray(values) for name, values in arrays.items() if values.size}
    arrays = {name: values.astype(values.dtype.newbyteorder("<"), copy=False) for name, values in arrays.items()}
    manifest = {
        "format": FORMAT, "version": VERSION, "identity": asdict(checkpoint.identity), "state": _numbers(state),
        "seed": checkpoint.seed,
        "arrays": [[name, values.dtype.str, list(values.shape)] for name, values in arrays.items()],
    }

    def write(file: IO[bytes]) -> None:
        if on_open is not None:
            on_open(file.fileno())
        # Sums of light hardly get smaller by packing.
        with zipfile.ZipFile(file, "w", zipfile.ZIP_STORED) as archive:
            archive.writestr(_MANIFEST, json.dumps(manifest, indent=1))
            if checkpoint.learned is not None:
                archive.writestr(_LEARNED, packed_field(checkpoint.learned))
            for name, values in arrays.items():
                with archive.open(_FOLDER + name, "w", force_zip64=True) as entry:
                    for piece in _pieces(values):
                        entry.write(piece)

    write_whole(path, write)


def sums_of(film: Film) -> dict[str, FilmTile]:
    """All sums of a film, of a film of strata those of each stratum too."""
    by_stratum: Film | None = getattr(film, "by_stratum", None)
    return {"film": film.sums} | ({} if by_stratum is None else {"by_stratum": by_stratum.sums})


def load_checkpoint(path: Path) -> Checkpoint:
    """Read a checkpoint but for the film.

    Raises
    ------
    FileNotFoundError
        If there is none.
    CheckpointError
        If it cannot be read, is no checkpoint, damaged, or of a later version.
    """
    with _Archive(path) as archive:
        return archive.checkpoint()


def load_film(path: Path, film: Film) -> None:
    """Read the film of a checkpoint that fits it (`Identity.difference`).

    Raises
    ------
    CheckpointError
        If it cannot be read, or is damaged; then the film holds anything.
    """
    with _Archive(path) as archive:
        for part, tile in sums_of(film).items():
            for name, values in tile._asdict().items():
                if values.size:
                    archive.read_into(f"{part}.{name}", values)


def _numbers(state: LoopState) -> dict[str, Any]:
    """What of a state are no arrays."""
    plain = asdict(replace(state, ends=(), looks=replace(state.looks, is_active=())))  # type: ignore[arg-type]
    del plain["ends"], plain["looks"]["is_active"]
    return plain


def _pieces(values: np.ndarray) -> Iterator[memoryview]:
    """Bytes of a C-ordered array, some at a time."""
    flat = values.reshape(-1).view(np.uint8).data
    return (flat[first : first + _AT_ONCE] for first in range(0, len(flat), _AT_ONCE))


class _Archive:
    """A file that is read; whatever is wrong with it, `CheckpointError` says."""

    def __init__(self, path: Path) -> None:
        self._path = path

    def __enter__(self) -> _Archive:
        try:
            self._file = open(self._path, "rb", opener=open_at_once)
            try:
                self._zip = zipfile.ZipFile(self._file)
                self._manifest = self._read_manifest()
                self._described = {name: (kind, tuple(shape)) for name, kind, shape in self._manifest["arrays"]}
            except BaseException:
                self._file.close()
                raise
        except (FileNotFoundError, CheckpointError):
            raise
        except OSError as error:
            raise CheckpointError(f"cannot be read ({error.strerror or error})") from error
        except Exception as error:
            # What is damaged may be anything, and so may be what reading it raises.
            raise CheckpointError(f"is damaged, or no checkpoint ({error})") from error
        return self

    def __exit__(self, *_error: object) -> None:
        self._zip.close()
        self._file.close()

    def _read_manifest(self) -> dict[str, Any]:
        if self._zip.getinfo(_MANIFEST).file_size > _MOST_MANIFEST_BYTES:
            raise ValueError("its manifest is too long")
        manifest = json.loads(self._zip.read(_MANIFEST))
        if not isinstance(manifest, dict) or manifest.get("format") != FORMAT:
            raise ValueError("its manifest is that of something else")
        if manifest.get("version") != VERSION:
            raise CheckpointError(f"was saved by another NeuralGuide (version {manifest.get('version')} of the file)")
        return manifest

    def checkpoint(self) -> Checkpoint:
        """All but the film."""
        try:
            numbers, identity = dict(self._manifest["state"]), Identity(**self._manifest["identity"])
            is_active = self._read("is_active", np.uint8).astype(np.bool_)
            looks = LooksState(**(numbers.pop("looks") | {"is_active": is_active}))
            state = LoopState(**(numbers | {"ends": self._read("ends", np.int32), "looks": looks}))
            state.check()
            seed = int(self._manifest["seed"])
            if not 0 <= seed <= MAX_SEED:
                raise ValueError(f"its seed is {seed}")
            return Checkpoint(identity, state, seed, self._learned())
        except CheckpointError:
            raise
        except Exception as error:
            raise CheckpointError(f"is damaged ({error})") from error

    def _learned(self) -> LearnedField | None:
        if _LEARNED not in self._zip.namelist():
            return None
        if self._zip.getinfo(_LEARNED).file_size > MOST_BYTES:
            raise ValueError("what it has learned is too large")
        return unpacked_field(self._path, self._zip.read(_LEARNED))

    def _read(self, name: str, dtype: type) -> np.ndarray:
        """A row of numbers; empty where the file has none."""
        _kind, shape = self._described.get(name, ("", (0,)))
        if self._zip_size(name) != math.prod(shape) * np.dtype(dtype).itemsize:
            raise ValueError(f"{name} has another size")
        values: np.ndarray = np.zeros(shape, dtype)
        if values.size:
            self.read_into(name, values)
        return values

    def _zip_size(self, name: str) -> int:
        return self._zip.getinfo(_FOLDER + name).file_size if name in self._described else 0

    def read_into(self, name: str, values: np.ndarray) -> None:
        """Read an array into one that has its type and shape."""
        described = (values.dtype.newbyteorder("<").str, values.shape)
        if self._described.get(name) != described:
            raise CheckpointError(f"is damaged ({name} is not {described[1]} of {described[0]})")
        read = np.empty(values.shape, described[0]) if values.dtype.byteorder == ">" else values
        try:
            with self._zip.open(_FOLDER + name) as entry:
                for piece in _pieces(read):
                    # Shorter bytes do not fit, and that is said.
                    piece[:] = entry.read(len(piece))
                if entry.read(1):
                    # Only at the end the checksum is looked at.
                    raise ValueError(f"{name} is too long")
        except Exception as error:
            raise CheckpointError(f"is damaged ({error})") from error
        if read is not values:
            values[:] = read
