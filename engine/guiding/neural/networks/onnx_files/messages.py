# SPDX-License-Identifier: GPL-3.0-or-later
"""Messages of ONNX: a model with its graph, written to bytes and read from them.

Only what our graphs use has a form of its own: tensors of float32 and int64, attributes that are integers. What else a
foreign file has is skipped, or refused where nothing can be made of it.

References
----------
ONNX, onnx.proto (IR version 10): numbers and meaning of fields.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from engine.guiding.neural.networks.onnx_files.protobuf import (
    BYTES,
    ProtobufError,
    bytes_field,
    content,
    integers,
    read_fields,
    signed,
    text,
    varint_field,
)

#: Versions of the format and of the set of operators that are written: onnxruntime 1.20 and later read them.
IR_VERSION = 10
OPSET = 22

#: Elements of tensors.
FLOAT, INT64 = 1, 7
_DTYPES: dict[int, np.dtype[Any]] = {FLOAT: np.dtype("<f4"), INT64: np.dtype("<i8")}
_ELEMENTS = {np.dtype(np.float32): FLOAT, np.dtype(np.int64): INT64}
#: Of an attribute that is an integer, and of one that is several.
_INT, _INTS = 2, 7

#: Sizes of a tensor's axes: a number, or a name where the size is free.
Dimensions = tuple[int | str, ...]


@dataclass(frozen=True)
class Node:
    """An operator's use: names of what it takes and gives, and integers that say how."""

    op_type: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, int | tuple[int, ...]] = field(default_factory=dict)


@dataclass(frozen=True)
class Value:
    """An input or output of a graph: name, element (FLOAT or INT64) and sizes."""

    name: str
    element: int
    dimensions: Dimensions


@dataclass(frozen=True)
class Graph:
    """Nodes in an order in which they can be done; initialisers are float32 or int64 arrays by name."""

    name: str
    nodes: tuple[Node, ...]
    initialisers: Mapping[str, np.ndarray]
    inputs: tuple[Value, ...]
    outputs: tuple[Value, ...]
    doc: str = ""


@dataclass(frozen=True)
class Model:
    """A graph with what else a file says: who wrote it, and texts by name."""

    graph: Graph
    metadata: Mapping[str, str]
    producer: str = ""
    producer_version: str = ""
    ir_version: int = IR_VERSION
    opset: int = OPSET


def write_model(model: Model) -> bytes:
    """A model as the bytes of an `.onnx` file."""
    parts = [
        varint_field(1, model.ir_version),
        bytes_field(2, model.producer),
        bytes_field(3, model.producer_version),
        bytes_field(7, *_graph_parts(model.graph)),
        bytes_field(8, bytes_field(1, ""), varint_field(2, model.opset)),
    ]
    parts += [
        bytes_field(14, bytes_field(1, name), bytes_field(2, value)) for name, value in model.metadata.items()
    ]
    return b"".join(parts)


def _graph_parts(graph: Graph) -> list[bytes]:
    parts = [_node(node, index) for index, node in enumerate(graph.nodes)]
    parts.append(bytes_field(2, graph.name))
    for name, array in graph.initialisers.items():
        parts.append(bytes_field(5, *_tensor_parts(name, array)))
    parts.append(bytes_field(10, graph.doc))
    parts += [_value(11, value) for value in graph.inputs]
    parts += [_value(12, value) for value in graph.outputs]
    return parts


def _node(node: Node, index: int) -> bytes:
    parts = [bytes_field(1, name) for name in node.inputs]
    parts += [bytes_field(2, name) for name in node.outputs]
    parts += [bytes_field(3, f"{node.op_type}_{index}"), bytes_field(4, node.op_type)]
    for name, value in node.attributes.items():
        if isinstance(value, int):
            stored = [varint_field(3, value), varint_field(20, _INT)]
        else:
            stored = [*(varint_field(8, one) for one in value), varint_field(20, _INTS)]
        parts.append(bytes_field(5, bytes_field(1, name), *stored))
    return bytes_field(1, *parts)


def _tensor_parts(name: str, array: np.ndarray) -> list[bytes]:
    element = _ELEMENTS[array.dtype]
    return [
        *(varint_field(1, size) for size in array.shape),
        varint_field(2, element),
        bytes_field(8, name),
        bytes_field(9, np.ascontiguousarray(array, _DTYPES[element]).tobytes()),
    ]


def _value(number: int, value: Value) -> bytes:
    sizes = (
        bytes_field(1, varint_field(1, size) if isinstance(size, int) else bytes_field(2, size))
        for size in value.dimensions
    )
    tensor = bytes_field(1, varint_field(1, value.element), bytes_field(2, *sizes))
    return bytes_field(number, bytes_field(1, value.name), bytes_field(2, tensor))


def read_metadata(data: bytes | memoryview) -> dict[str, str]:
    """Texts that a model has by name, of any ONNX file; the graph is not looked at.

    Raises
    ------
    ProtobufError
        Where the bytes are no message.
    """
    metadata = {}
    for entry in read_fields(data):
        if entry.number == 14:
            parts = {part.number: text(part) for part in read_fields(content(entry))}
            metadata[parts.get(1, "")] = parts.get(2, "")
    return metadata


def read_model(data: bytes | memoryview) -> Model:
    """A model from the bytes of an `.onnx` file. Arrays are views of the bytes, and cannot be written.

    Raises
    ------
    ProtobufError
        Where the bytes are no model, or one with tensors or attributes of other kinds than ours have.
    """
    graph = None
    ir_version, opset, producer, producer_version = 0, 0, "", ""
    for entry in read_fields(data):
        if entry.number == 1:
            ir_version = signed(entry)
        elif entry.number == 2:
            producer = text(entry)
        elif entry.number == 3:
            producer_version = text(entry)
        elif entry.number == 7:
            graph = _read_graph(content(entry))
        elif entry.number == 8:
            parts = {part.number: part for part in read_fields(content(entry))}
            if 1 not in parts or not text(parts[1]):
                opset = signed(parts[2]) if 2 in parts else 0
    if graph is None:
        raise ProtobufError("it has no graph")
    return Model(graph, read_metadata(data), producer, producer_version, ir_version, opset)


def _read_graph(data: memoryview) -> Graph:
    name, doc = "", ""
    nodes, inputs, outputs = [], [], []
    initialisers: dict[str, np.ndarray] = {}
    for entry in read_fields(data):
        if entry.number == 1:
            nodes.append(_read_node(content(entry)))
        elif entry.number == 2:
            name = text(entry)
        elif entry.number == 5:
            tensor_name, array = _read_tensor(content(entry))
            initialisers[tensor_name] = array
        elif entry.number == 10:
            doc = text(entry)
        elif entry.number == 11:
            inputs.append(_read_value(content(entry)))
        elif entry.number == 12:
            outputs.append(_read_value(content(entry)))
    return Graph(name, tuple(nodes), initialisers, tuple(inputs), tuple(outputs), doc)


def _read_node(data: memoryview) -> Node:
    inputs, outputs, op_type = [], [], ""
    attributes: dict[str, int | tuple[int, ...]] = {}
    for entry in read_fields(data):
        if entry.number == 1:
            inputs.append(text(entry))
        elif entry.number == 2:
            outputs.append(text(entry))
        elif entry.number == 4:
            op_type = text(entry)
        elif entry.number == 5:
            name, value = _read_attribute(content(entry))
            attributes[name] = value
    return Node(op_type, tuple(inputs), tuple(outputs), attributes)


def _read_attribute(data: memoryview) -> tuple[str, int | tuple[int, ...]]:
    name, kind, single = "", 0, 0
    several: list[int] = []
    for entry in read_fields(data):
        if entry.number == 1:
            name = text(entry)
        elif entry.number == 3:
            single = signed(entry)
        elif entry.number == 8:
            several += integers(entry)
        elif entry.number == 20:
            kind = signed(entry)
    if kind not in (_INT, _INTS):
        raise ProtobufError(f"attribute {name!r} is of type {kind}: only integers are known")
    return name, single if kind == _INT else tuple(several)


def _read_tensor(data: memoryview) -> tuple[str, np.ndarray]:
    name, element, raw = "", 0, memoryview(b"")
    sizes: list[int] = []
    for entry in read_fields(data):
        if entry.number == 1:
            sizes += integers(entry)
        elif entry.number == 2:
            element = signed(entry)
        elif entry.number == 8:
            name = text(entry)
        elif entry.number == 9:
            raw = content(entry)
        elif entry.number in (4, 5, 6, 7, 10, 11, 13):
            raise ProtobufError(f"tensor {name!r} does not hold its values as raw data")
    if element not in _DTYPES:
        raise ProtobufError(f"tensor {name!r} has elements of type {element}: only float32 and int64 are known")
    dtype = _DTYPES[element]
    count = 1
    for size in sizes:
        if size < 0:
            raise ProtobufError(f"tensor {name!r} has a negative size")
        count *= size
    if count * dtype.itemsize != len(raw):
        raise ProtobufError(f"tensor {name!r} has {len(raw)} bytes, its sizes {sizes} ask for {count * dtype.itemsize}")
    return name, np.frombuffer(raw, dtype).reshape(sizes)


def _read_value(data: memoryview) -> Value:
    name, element = "", 0
    dimensions: list[int | str] = []
    for entry in read_fields(data):
        if entry.number == 1:
            name = text(entry)
        elif entry.number == 2:
            for kind in read_fields(content(entry)):
                if kind.number != 1:
                    raise ProtobufError(f"{name!r} is no tensor")
                for part in read_fields(content(kind)):
                    if part.number == 1:
                        element = signed(part)
                    elif part.number == 2:
                        dimensions = [_read_dimension(content(size)) for size in read_fields(content(part))]
    return Value(name, element, tuple(dimensions))


def _read_dimension(data: memoryview) -> int | str:
    for entry in read_fields(data):
        if entry.number in (1, 2):
            return text(entry) if entry.kind == BYTES else signed(entry)
    return ""
