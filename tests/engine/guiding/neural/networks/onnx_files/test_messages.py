# SPDX-License-Identifier: GPL-3.0-or-later
"""ONNX's messages and the wire format below them: what is written is read again, and package onnx reads it alike."""

from __future__ import annotations

import numpy as np
import pytest

from engine.guiding.neural.networks.onnx_files import messages
from engine.guiding.neural.networks.onnx_files.graph import GraphBuilder
from engine.guiding.neural.networks.onnx_files.messages import (
    FLOAT,
    INT64,
    Graph,
    Model,
    Node,
    Value,
    read_metadata,
    read_model,
    write_model,
)
from engine.guiding.neural.networks.onnx_files.protobuf import (
    ProtobufError,
    bytes_field,
    integers,
    read_fields,
    signed,
    text,
    varint_field,
    write_varint,
)

MODEL = Model(
    Graph(
        "sums",
        (
            Node("Concat", ("x", "x"), ("twice",), {"axis": -1}),
            Node("Transpose", ("twice",), ("turned",), {"perm": (1, 0)}),
            Node("Add", ("turned", "one"), ("y",)),
        ),
        {"one": np.ones((), np.float32), "unused": np.array([[-1, 1 << 40]], np.int64)},
        (Value("x", FLOAT, ("N", 2)),),
        (Value("y", FLOAT, (4, "N")),),
        "x beside itself, turned, and one more",
    ),
    {"a": "1", "ü": "{}"},
    "a test",
    "1",
)


@pytest.mark.parametrize(
    "value, stored", [(0, b"\x00"), (1, b"\x01"), (300, b"\xac\x02"), (-1, b"\xff" * 9 + b"\x01"), (1 << 63, None)]
)
def test_integers_are_stored_seven_bits_a_byte(value, stored):
    assert stored is None or write_varint(value) == stored
    (found,) = read_fields(varint_field(5, value))
    assert found.number == 5
    assert signed(found) == (value if value < 1 << 63 else value - (1 << 64))


def test_repeated_integers_may_be_packed():
    (packed,) = read_fields(bytes_field(1, write_varint(3), write_varint(-2)))
    assert integers(packed) == [3, -2]


@pytest.mark.parametrize(
    "data, why",
    [
        (b"\x08", "ends within a number"),
        (b"\x08" + b"\xff" * 11, "more than ten"),
        (b"\x0a\x05ab", "ends within a field"),
        (b"\x0d\x01\x02", "ends within a field"),
        (b"\x0b", "unknown kind 3"),
        (b"\x00\x00", "number 0"),
    ],
)
def test_damaged_messages_are_refused(data, why):
    with pytest.raises(ProtobufError, match=why):
        list(read_fields(data))


def test_text_must_be_text():
    (field,) = read_fields(bytes_field(1, b"\xff\xfe"))
    with pytest.raises(ProtobufError, match="no text"):
        text(field)


def test_models_come_back():
    data = write_model(MODEL)
    back = read_model(data)
    assert back.metadata == MODEL.metadata == read_metadata(data)
    assert back.graph.nodes == MODEL.graph.nodes
    assert back.graph.inputs == MODEL.graph.inputs and back.graph.outputs == MODEL.graph.outputs
    assert (back.graph.name, back.graph.doc) == (MODEL.graph.name, MODEL.graph.doc)
    assert (back.producer, back.ir_version, back.opset) == ("a test", messages.IR_VERSION, messages.OPSET)
    for name, array in MODEL.graph.initialisers.items():
        found = back.graph.initialisers[name]
        assert found.dtype == array.dtype and np.array_equal(found, array) and found.shape == array.shape
    assert write_model(back) == data


def test_tensors_of_other_sizes_than_they_say_are_refused():
    tensor = bytes_field(5, varint_field(1, 1 << 60), varint_field(2, INT64), bytes_field(8, "t"), bytes_field(9, b""))
    with pytest.raises(ProtobufError, match="'t' has 0 bytes"):
        read_model(bytes_field(7, tensor))
    outside = bytes_field(5, varint_field(2, FLOAT), bytes_field(8, "t"), bytes_field(13, b""))
    with pytest.raises(ProtobufError, match="raw data"):
        read_model(bytes_field(7, outside))


def test_a_graph_reads_all_that_it_has():
    graph = GraphBuilder()
    graph.output("y", graph.add("Mul", graph.input("x", ("N",)), graph.floats(2.0)), ("N",))
    assert [node.op_type for node in graph.graph("twice", "").nodes] == ["Mul", "Identity"]
    graph.initialiser("bias", np.zeros(3, np.float32))
    with pytest.raises(ValueError, match="nothing in the graph 'twice' reads bias"):
        graph.graph("twice", "")


def test_package_onnx_reads_them_alike():
    onnx = pytest.importorskip("onnx")
    model = onnx.load_from_string(write_model(MODEL))
    onnx.checker.check_model(model, full_check=True)
    assert [node.op_type for node in model.graph.node] == ["Concat", "Transpose", "Add"]
    assert list(model.graph.node[1].attribute[0].ints) == [1, 0] and model.graph.node[0].attribute[0].i == -1
    assert {entry.key: entry.value for entry in model.metadata_props} == MODEL.metadata
    for tensor in model.graph.initializer:
        assert np.array_equal(onnx.numpy_helper.to_array(tensor), MODEL.graph.initialisers[tensor.name])
    # What it writes, in an order and a way of its own, is read here.
    assert read_model(model.SerializeToString()).graph.nodes == MODEL.graph.nodes
