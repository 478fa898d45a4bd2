# SPDX-License-Identifier: GPL-3.0-or-later
"""Bundles as tables: a column is declared once, where its class lists it, and all that handles tables goes by that.

    class Toy(Bundle):
        '''Toys, R rows.'''

        color: Float32Array = column("RGB", "R", 3)
        parent: Int32Array = column("row of another toy, -1 = none", "R", fill=-1)

The annotation says the column's dtype, `column` its meaning and its shape, in sizes that are numbers or have names.
`allocate` makes a table, `rows_of`, `copy_of` and `joined` are the same whatever the columns are, and docs/columns.md
lists them. Kernels see the bundle as if its fields had been written without `column`.

Numbers that kernels address within the rows of one array are declared in the same way, by a `RowLayout`.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Any, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
import numpy.typing as npt

from engine.runtime.bundle import Bundle

_CACHE_LINE = 64
Table = TypeVar("Table", bound=Bundle)


@dataclass(frozen=True)
class Column:
    """One column of a table.

    Attributes
    ----------
    about : str
        What it holds, in words, with unit and space.
    shape : tuple of int or str
        Its sizes, the rows first. A name is looked up when a table is allocated.
    fill : float
        What a new table has in it.
    needs : str
        Attribute of the `has` of `allocate` without which it has no rows; '': it always has.
    merge : Enum, optional
        How rows of two tables become one, where they do.
    weight : str
        Column of the weights that it is a sum by, where `merge` asks for one.
    line : int
        Cache line of a row's record that it lies in; -1: it is an array of its own.
    record : int
        Which record, where a row has several.
    is_dynamic : bool
        Whether its width is no part of the bundle's type (`Bundle._dynamic`).
    """

    about: str
    shape: tuple[int | str, ...]
    fill: float = 0.0
    needs: str = ""
    merge: Enum | None = None
    weight: str = ""
    line: int = -1
    record: int = 0
    is_dynamic: bool = False

    def __set_name__(self, owner: type[Bundle], name: str) -> None:
        if self.is_dynamic:
            owner._dynamic = owner._dynamic | {name}


class RowLayout:
    """Numbers that lie side by side in a row of one array, in the order in which they are declared.

        _toy = RowLayout()
        TOY_COLOR = _toy.take(3)
        TOY_SIZE = _toy.take()
        TOY_WIDTH = _toy.width()
    """

    def __init__(self) -> None:
        self._taken = 0

    def take(self, count: int = 1) -> int:
        """First column of `count` more."""
        first = self._taken
        self._taken += count
        return first

    def width(self, multiple: int = 1) -> int:
        """Columns of a row, rounded up to a multiple."""
        return -(-self._taken // multiple) * multiple


#: What has been read of a class: its columns and their dtypes.
_DECLARED: dict[type[Bundle], dict[str, tuple[Column, np.dtype]]] = {}


def column(about: str, *shape: int | str, **options: Any) -> Any:
    """Declare a column, as the value of an annotated field of a bundle.

    Parameters
    ----------
    about, *shape, **options
        As the attributes of `Column`.
    """
    return Column(about, shape, **options)


def columns_of(table: type[Bundle]) -> dict[str, Column]:
    """Columns of a class of tables by name, in the order of its fields.

    Raises
    ------
    TypeError
        If a field that is an array is not declared by `column`.
    """
    return {name: declared for name, (declared, _dtype) in _declared(table).items()}


def dtype_of(table: type[Bundle], name: str) -> np.dtype:
    """Type of the elements of a column."""
    return _declared(table)[name][1]


def _declared(table: type[Bundle]) -> dict[str, tuple[Column, np.dtype]]:
    if table not in _DECLARED:
        _DECLARED[table] = dict(_read(table))
    return _DECLARED[table]


def _read(table: type[Bundle]) -> Iterator[tuple[str, tuple[Column, np.dtype]]]:
    hints = get_type_hints(table)
    for name in table._fields:
        element = _element(hints[name])
        if element is None:
            continue
        declared = getattr(table, name, None)
        if not isinstance(declared, Column):
            raise TypeError(f"{table.__name__}.{name} is not declared by column()")
        yield name, (declared, np.dtype(element))


def _element(hint: Any) -> Any:
    """Type of the elements of `NDArray[...]`, None of any other annotation."""
    origin, arguments = get_origin(hint), get_args(hint)
    if origin is np.ndarray:
        # ndarray[shape, dtype[float32]]
        (element,) = get_args(arguments[1])
    elif origin is npt.NDArray:
        # An alias that keeps its name, from numpy 2.5 on.
        (element,) = arguments
    else:
        return None
    return element


def allocate(table: type[Table], sizes: Mapping[str, int], has: Any = None, **given: Any) -> Table:
    """A new table.

    Parameters
    ----------
    sizes : mapping of str to int
        Sizes that the columns' shapes name.
    has : object, optional
        Whose attributes say which columns have rows (`Column.needs`).
    **given
        Fields that have been made apart.
    """
    fields = dict(given)
    records: dict[int, dict[str, Column]] = {}
    for name, (declared, dtype) in _declared(table).items():
        if name in given:
            continue
        is_needed = not declared.needs or getattr(has, declared.needs)
        if is_needed and declared.line >= 0:
            records.setdefault(declared.record, {})[name] = declared
            continue
        shape = (_size(declared.shape[0], sizes) if is_needed else 0, *_inner(declared, sizes))
        # Zeroed memory is none before it is written.
        fields[name] = np.full(shape, declared.fill, dtype) if declared.fill else np.zeros(shape, dtype)
    for columns in records.values():
        fields |= _in_lines(table, columns, sizes)
    return table(**fields)


def without(table: type[Bundle], need: str) -> dict[str, np.ndarray]:
    """Columns as tables have them that lack what `need` names (`Column.needs`): without rows."""
    return {
        name: np.zeros((0, *_inner(declared, {})), dtype_of(table, name))
        for name, declared in columns_of(table).items()
        if declared.needs == need
    }


def _size(size: int | str, sizes: Mapping[str, int]) -> int:
    return sizes[size] if isinstance(size, str) else size


def _inner(declared: Column, sizes: Mapping[str, int]) -> tuple[int, ...]:
    """Sizes of a row."""
    return tuple(_size(size, sizes) for size in declared.shape[1:])


def _in_lines(table: type[Bundle], columns: Mapping[str, Column], sizes: Mapping[str, int]) -> dict[str, np.ndarray]:
    """Columns whose rows lie side by side in records of whole cache lines, as views; within a line as declared."""
    names: list[str] = []
    formats: list[Any] = []
    offsets: list[int] = []
    size = 0
    for line in sorted({declared.line for declared in columns.values()}):
        for name, declared in columns.items():
            if declared.line == line:
                inner = _inner(declared, sizes)
                kind = np.dtype((dtype_of(table, name), inner)) if inner else dtype_of(table, name)
                names.append(name)
                formats.append(kind)
                offsets.append(size)
                size += kind.itemsize
        size += -size % _CACHE_LINE
    record = np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": size})
    (row_count,) = {_size(declared.shape[0], sizes) for declared in columns.values()}
    memory = aligned_bytes(row_count * record.itemsize).view(record)
    for name, declared in columns.items():
        if declared.fill:
            memory[name] = declared.fill
    return {name: memory[name] for name in names}


def aligned_bytes(byte_count: int) -> np.ndarray:
    """Zeroed uint8 array that begins at a cache line."""
    memory = np.zeros(byte_count + _CACHE_LINE, np.uint8)
    start = -memory.ctypes.data % _CACHE_LINE
    return memory[start : start + byte_count]


def rows_of(table: Table, first: int, last: int) -> Table:
    """Some rows, as views; columns without rows stay so."""
    return type(table)(*(values[first:last] for values in table))


def copy_of(table: Table) -> Table:
    """The same in arrays of its own."""
    return type(table)(*(values.copy() for values in table))


def joined(tables: Sequence[Table]) -> Table:
    """Rows of all tables one after the other."""
    columns = [np.ascontiguousarray(np.concatenate(values)) for values in zip(*tables, strict=True)]
    return type(tables[0])(*columns)
