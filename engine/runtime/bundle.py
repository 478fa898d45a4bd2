# SPDX-License-Identifier: GPL-3.0-or-later
"""`Bundle`: a named group of arrays that a kernel takes as one pointer.

Numba passes an array as seven words and a named tuple as all its arrays' words, at every call that is not inlined: a
hundred stores before the first useful instruction, and a reference count for each array. A bundle is one word. Reading
a field loads the array's address from a table; the loads are marked invariant, so LLVM hoists them out of loops. Sizes
of all dimensions but the first are constants of the type, unless the class lists the field in `_dynamic`.

In kernels a field is one word too (`FieldType`), which has elements and a shape; indices must not be negative, since
nothing tests for it. A slice of it is an ordinary array, which can be read and written. Fields cannot be assigned:
`_replace` makes a new bundle of the same arrays. A field may be a bundle too: what a compiled loop hands to many stages
comes as one.

A bundle of lanes (`_rows` set) goes further, for data read by lane in every stage: its fields may be strided views of
one array of records, so that a lane's data lie in few cache lines, and in kernels they are bare pointers (`RowsType`)
with constant strides: only elements can be read and written.
"""

from __future__ import annotations

import hashlib
import inspect
import operator
from collections.abc import Iterator
from typing import Any, ClassVar, Self

import numpy as np
from llvmlite import ir
from numba import from_dtype, typeof, types
from numba.core import cgutils
from numba.core.imputils import lower_builtin, lower_cast, lower_getattr, lower_getattr_generic
from numba.core.typeconv import Conversion
from numba.core.typing.templates import AbstractTemplate, AttributeTemplate, infer_global, signature
from numba.extending import NativeValue, infer_getattr, models, register_model, unbox
from numba.np.arrayobj import make_array, populate_array

from engine.runtime.bounds import is_checked, within

#: Words per field in a bundle's table: address, then the shape.
_FIELD_WORDS = 4
#: Size of a number of a named tuple.
_WORD_BYTES = 8
#: Types of bundles by the class and what decides it of each field.
_TYPES: dict[tuple[Any, ...], BundleType] = {}


class Bundle:
    """Base class: annotate fields in the subclass, construct by position or keyword.

    A field is a C-contiguous array of at most three dimensions, another bundle, a table of stages, a named tuple of
    numbers, which kernels read as such, or a tuple of ints (`channels`), which becomes part of the type.
    """

    _fields: ClassVar[tuple[str, ...]] = ()
    #: Fields whose inner dimensions vary from scene to scene: they must not be part of the type.
    _dynamic: ClassVar[frozenset[str]] = frozenset()
    #: Fields that hold bundles of any class, which is no part of the type: kernels only pass them on (`OpaqueType`).
    _opaque: ClassVar[frozenset[str]] = frozenset()
    #: Whether fields are `RowsType` in kernels.
    _rows: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        # A subclass has the fields of its base first.
        classes = (inspect.get_annotations(base) for base in reversed(cls.__mro__))
        cls._fields = tuple(name for fields in classes for name in fields if not name.startswith("_"))

    def __init__(self, *arrays: Any, **named: Any) -> None:
        values = dict(zip(self._fields, arrays, strict=False), **named)
        if len(arrays) + len(named) != len(self._fields) or set(values) != set(self._fields):
            raise TypeError(f"{type(self).__name__} takes the fields {', '.join(self._fields)}")
        for name, value in values.items():
            if isinstance(value, tuple) or hasattr(value, "_address"):
                continue
            is_array = isinstance(value, np.ndarray) and 1 <= value.ndim <= 3
            if not (is_array and (self._rows or value.flags.c_contiguous)):
                raise TypeError(f"{type(self).__name__}.{name} must be a C-contiguous array of 1 to 3 dimensions")
        self.__dict__.update(values)

    # What kernels read is made when the first one asks: many bundles are never given to any.

    @property
    def _address(self) -> int:
        """Address of the table."""
        known: int | None = self.__dict__.get("_known_address")
        if known is None:
            # Threads that ask at the same time make a table each, and all use that of the first.
            made = self._make_table()
            table, _ = self.__dict__.setdefault("_table", made)
            known = self.__dict__["_known_address"] = int(table.ctypes.data)
        return known

    @property
    def _numba_type_(self) -> BundleType:
        known: BundleType | None = self.__dict__.get("_known_type")
        if known is None:
            known = self.__dict__["_known_type"] = self._describe()
        return known

    def _make_table(self) -> tuple[np.ndarray, list[np.ndarray]]:
        """Words of all fields, and what they point to that is nobody else's."""
        table = np.zeros(max(len(self._fields), 1) * _FIELD_WORDS, np.int64)
        packed: list[np.ndarray] = []
        for index, name in enumerate(self._fields):
            value = self.__dict__[name]
            word = index * _FIELD_WORDS
            if isinstance(value, tuple) and hasattr(value, "_fields"):
                stored = np.zeros((len(value), _WORD_BYTES), np.uint8)
                for row, number in zip(stored, value, strict=True):
                    stored_as = np.asarray(number)
                    row[: stored_as.nbytes] = np.frombuffer(stored_as.tobytes(), np.uint8)
                packed.append(stored)
                table[word] = stored.ctypes.data
            elif hasattr(value, "_address"):
                table[word] = value._address
            elif isinstance(value, np.ndarray):
                table[word] = value.ctypes.data
                table[word + 1 : word + 1 + value.ndim] = value.shape
        return table, packed

    def _describe(self) -> BundleType:
        """The type; that of the last bundle whose fields are alike, since making one takes long."""
        alike: list[Any] = [type(self)]
        for name in self._fields:
            value = self.__dict__[name]
            if name in self._opaque:
                continue
            if isinstance(value, np.ndarray):
                alike.append((value.dtype, value.shape[1:], value.strides if self._rows else None))
            elif hasattr(value, "_address"):
                alike.append(value._numba_type_)
            elif hasattr(value, "_fields"):
                alike.append((type(value), *map(type, value)))
            else:
                alike.append(value)
        key = tuple(alike)
        known = _TYPES.get(key)
        if known is None:
            known = _TYPES[key] = self._new_type()
        return known

    def _new_type(self) -> BundleType:
        described: list[tuple[str, Any]] = []
        for name in self._fields:
            value = self.__dict__[name]
            if name in self._opaque:
                described.append((name, OPAQUE))
            elif isinstance(value, tuple):
                described.append((name, typeof(value) if hasattr(value, "_fields") else value))
            elif hasattr(value, "_address"):
                described.append((name, value._numba_type_))
            elif self._rows:
                described.append((name, RowsType(from_dtype(value.dtype), value.shape[1:], value.strides)))
            else:
                inner = (-1,) * (value.ndim - 1) if name in self._dynamic else value.shape[1:]
                described.append((name, FieldType(from_dtype(value.dtype), inner)))
        return BundleType(type(self).__name__, tuple(described))

    def __setattr__(self, name: str, value: Any) -> None:
        raise AttributeError(f"{type(self).__name__}.{name} cannot be assigned: use _replace")

    def __iter__(self) -> Iterator[Any]:
        return (getattr(self, name) for name in self._fields)

    def __reduce__(self) -> Any:
        return (type(self), tuple(self))

    def _asdict(self) -> dict[str, Any]:
        """Fields by name."""
        return {name: getattr(self, name) for name in self._fields}

    def _replace(self, **changes: Any) -> Self:
        """A bundle of the same arrays but for `changes`."""
        return type(self)(**{**self._asdict(), **changes})


class RowsType(types.Type):
    """Numba's type of a field of a bundle of lanes: a pointer; strides [bytes], one a dimension, are constants.

    Where indices are looked at it is what a `FieldType` is, whose table knows the number of rows.
    """

    def __init__(self, dtype: types.Type, inner: tuple[int, ...], strides: tuple[int, ...]) -> None:
        self.dtype, self.inner, self.strides = dtype, inner, strides
        super().__init__(name=f"Rows({dtype}, {inner}, {strides})")


class FieldType(types.Type):
    """Numba's type of any other array of a bundle: where in the bundle's table its address and its shape are.

    inner : tuple of int, sizes of all dimensions but the first; -1: no part of the type
    """

    def __init__(self, dtype: types.Type, inner: tuple[int, ...]) -> None:
        self.dtype, self.inner = dtype, inner
        self.dimensions = 1 + len(inner)
        self.array_type = types.Array(dtype, self.dimensions, "C")
        super().__init__(name=f"Field({dtype}, {inner})")

    def can_convert_to(self, typingctx: Any, other: types.Type) -> Conversion | None:
        """To the array that it is."""
        return Conversion.safe if other == self.array_type else None


class AddressType(types.Type):
    """Numba's type of an object that kernels know by its address."""


class OpaqueType(AddressType):
    """Numba's type of a bundle that kernels pass on without knowing its class."""

    def __init__(self) -> None:
        super().__init__(name="Opaque")


OPAQUE = OpaqueType()


class BundleType(AddressType):
    """Numba's type of a bundle: its name; by field a tuple, or the type of a named tuple, bundle, rows or field."""

    def __init__(self, name: str, fields: tuple[tuple[str, Any], ...]) -> None:
        self.class_name = name
        self.fields = fields
        self.index = {field: k for k, (field, _) in enumerate(fields)}
        # Short, since it is a part of the names of all machine code that takes such a bundle.
        digest = hashlib.blake2b(repr(fields).encode(), digest_size=10).hexdigest()
        super().__init__(name=f"{name}_{digest}")

    def field_type(self, name: str) -> types.Type | None:
        """Numba type of a field, None if there is no such field."""
        if name not in self.index:
            return None
        described = self.fields[self.index[name]][1]
        if _is_tuple_field(described):
            return types.UniTuple(types.int64, len(described))
        field_type: types.Type = described
        return field_type


def _is_tuple_field(described: Any) -> bool:
    return isinstance(described, tuple)


@register_model(OpaqueType)
@register_model(BundleType)
class AddressModel(models.PrimitiveModel):
    """In kernels an object is the address it has in Python."""

    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.IntType(64))


@unbox(BundleType)
def unbox_address(typ: types.Type, obj: Any, c: Any) -> NativeValue:
    """Read an object's `_address`."""
    address = c.pyapi.object_getattr_string(obj, "_address")
    value = c.pyapi.long_as_longlong(address)
    c.pyapi.decref(address)
    return NativeValue(value)


@infer_getattr
class _BundleAttributes(AttributeTemplate):
    key = BundleType

    def generic_resolve(self, typ: BundleType, attr: str) -> types.Type | None:
        return typ.field_type(attr)


def _word(builder: Any, table: Any, offset: int) -> Any:
    """One word of a bundle's table, which nobody changes."""
    intp = ir.IntType(64)
    loaded = builder.load(builder.gep(builder.inttoptr(table, intp.as_pointer()), [ir.Constant(intp, offset)]))
    # Where indices are looked at, the table of what lies on the stack has just been written.
    if not is_checked:
        loaded.set_metadata("invariant.load", builder.module.add_metadata([]))
    return loaded


@lower_getattr_generic(BundleType)
def _lower_attribute(context: Any, builder: Any, typ: BundleType, value: Any, attr: str) -> Any:
    index = typ.index[attr]
    described = typ.fields[index][1]
    if _is_tuple_field(described):
        result = context.get_constant_generic(builder, types.UniTuple(types.int64, len(described)), described)
        return result
    intp = ir.IntType(64)
    if isinstance(described, FieldType) or (is_checked and isinstance(described, RowsType)):
        return builder.add(value, ir.Constant(intp, index * _FIELD_WORDS * _WORD_BYTES))
    first = _word(builder, value, index * _FIELD_WORDS)
    if isinstance(described, RowsType):
        return builder.inttoptr(first, context.get_value_type(described))
    if isinstance(described, AddressType):
        return first
    values = []
    for position, number_type in enumerate(described.types):
        address = builder.add(first, ir.Constant(intp, position * _WORD_BYTES))
        pointer = builder.inttoptr(address, context.get_value_type(number_type).as_pointer())
        values.append(builder.load(pointer))
        values[-1].set_metadata("invariant.load", builder.module.add_metadata([]))
    return context.make_tuple(builder, described, values)


register_model(FieldType)(AddressModel)


def _shape_of(builder: Any, field: FieldType | RowsType, value: Any) -> list[Any]:
    sizes = [_word(builder, value, 1)]
    for axis, size in enumerate(field.inner, start=1):
        sizes.append(ir.Constant(ir.IntType(64), size) if size >= 0 else _word(builder, value, 1 + axis))
    return sizes


def _strides_of(context: Any, builder: Any, field: FieldType, value: Any) -> list[Any]:
    """In bytes."""
    strides = [ir.Constant(ir.IntType(64), context.get_abi_sizeof(context.get_data_type(field.dtype)))]
    for size in reversed(_shape_of(builder, field, value)[1:]):
        strides.insert(0, builder.mul(strides[0], size))
    return strides


@infer_getattr
class _FieldAttributes(AttributeTemplate):
    key = FieldType

    def generic_resolve(self, typ: FieldType, attr: str) -> types.Type | None:
        return types.UniTuple(types.int64, typ.dimensions) if attr == "shape" else None


@lower_getattr(FieldType, "shape")
def _lower_shape(context: Any, builder: Any, typ: FieldType, value: Any) -> Any:
    return cgutils.pack_array(builder, _shape_of(builder, typ, value))


def array_of(context: Any, builder: Any, typ: types.Type, value: Any) -> Any:
    """Numba's structure of an array, for intrinsics: of one, or of a bundle's field."""
    if not isinstance(typ, FieldType):
        return make_array(typ)(context, builder, value)
    array = make_array(typ.array_type)(context, builder)
    data_type = context.get_data_type(typ.dtype)
    populate_array(
        array,
        data=builder.inttoptr(_word(builder, value, 0), data_type.as_pointer()),
        shape=cgutils.pack_array(builder, _shape_of(builder, typ, value)),
        strides=cgutils.pack_array(builder, _strides_of(context, builder, typ, value)),
        itemsize=ir.Constant(ir.IntType(64), context.get_abi_sizeof(data_type)),
        meminfo=None,
    )
    return array


@lower_cast(FieldType, types.Array)
def _cast_to_array(context: Any, builder: Any, fromty: FieldType, toty: types.Array, value: Any) -> Any:
    return array_of(context, builder, fromty, value)._getvalue()


@register_model(RowsType)
class _RowsModel(models.PrimitiveModel):
    def __init__(self, dmm: Any, fe_type: Any) -> None:
        super().__init__(dmm, fe_type, ir.IntType(64) if is_checked else ir.IntType(8).as_pointer())


def start_of_rows(builder: Any, value: Any) -> Any:
    """Where a `RowsType` begins: an untyped pointer."""
    return builder.inttoptr(_word(builder, value, 0), ir.IntType(8).as_pointer()) if is_checked else value


def rows_at(builder: Any, start: Any, count: int) -> Any:
    """A `RowsType` of memory that is no field: an untyped pointer to so many rows."""
    if not is_checked:
        return start
    word = ir.IntType(64)
    table = cgutils.alloca_once(builder, ir.ArrayType(word, 2))
    values = builder.ptrtoint(start, word), ir.Constant(word, count)
    for position, value in enumerate(values):
        builder.store(value, cgutils.gep_inbounds(builder, table, 0, position))
    return builder.ptrtoint(table, word)


def _index_types(index: Any) -> tuple | None:
    """Types of the indices of an element, None if it is anything else (a slice, an array)."""
    parts = tuple(index) if isinstance(index, types.BaseTuple) else (index,)
    return parts if all(isinstance(part, types.Integer) for part in parts) else None


def _is_element(array: Any, index: Any) -> bool:
    parts = _index_types(index)
    dimensions = array.dimensions if isinstance(array, FieldType) else len(array.strides)
    return parts is not None and len(parts) == dimensions


@infer_global(operator.getitem)
class _GetItem(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        array, index = args
        if isinstance(array, (RowsType, FieldType)) and _is_element(array, index):
            return signature(array.dtype, array, index)
        if isinstance(array, FieldType):
            return self.context.resolve_function_type(operator.getitem, (array.array_type, index), {})
        return None


@infer_global(operator.setitem)
class _SetItem(AbstractTemplate):
    def generic(self, args: Any, kws: Any) -> Any:
        array, index, _value = args
        if isinstance(array, (RowsType, FieldType)) and _is_element(array, index):
            return signature(types.none, array, index, array.dtype)
        return None


def _element_pointer(context: Any, builder: Any, array: Any, value: Any, index_type: Any, index: Any) -> Any:
    """Address of one element, as a pointer to the data type's stored form."""
    intp = ir.IntType(64)
    if isinstance(array, FieldType):
        strides = _strides_of(context, builder, array, value)
        start = builder.inttoptr(_word(builder, value, 0), ir.IntType(8).as_pointer())
    else:
        strides, start = [ir.Constant(intp, stride) for stride in array.strides], start_of_rows(builder, value)
    sizes = _shape_of(builder, array, value) if is_checked else [None] * len(strides)
    parts = _index_types(index_type)
    assert parts is not None
    values = cgutils.unpack_tuple(builder, index) if isinstance(index_type, types.BaseTuple) else [index]
    offset = ir.Constant(intp, 0)
    for axis, (part, part_value, stride, size) in enumerate(zip(parts, values, strides, sizes, strict=True)):
        position = context.cast(builder, part_value, part, types.intp)
        position = within(context, builder, position, size, f"axis {axis} of {array}")
        offset = builder.add(offset, builder.mul(position, stride, flags=["nsw"]), flags=["nsw"])
    return builder.bitcast(builder.gep(start, [offset]), context.get_data_type(array.dtype).as_pointer())


@lower_builtin(operator.getitem, FieldType, types.Any)
@lower_builtin(operator.getitem, RowsType, types.Any)
def _lower_getitem(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array, index_type = sig.args
    pointer = _element_pointer(context, builder, array, args[0], index_type, args[1])
    return context.unpack_value(builder, array.dtype, pointer)


@lower_builtin(operator.setitem, FieldType, types.Any, types.Any)
@lower_builtin(operator.setitem, RowsType, types.Any, types.Any)
def _lower_setitem(context: Any, builder: Any, sig: Any, args: Any) -> Any:
    array, index_type, value_type = sig.args
    pointer = _element_pointer(context, builder, array, args[0], index_type, args[1])
    context.pack_value(builder, array.dtype, context.cast(builder, args[2], value_type, array.dtype), pointer)
    return context.get_dummy_value()
