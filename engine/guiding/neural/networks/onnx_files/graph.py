# SPDX-License-Identifier: GPL-3.0-or-later
"""`GraphBuilder`: nodes one after the other, values by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from engine.guiding.neural.networks.onnx_files.messages import FLOAT, Dimensions, Graph, Node, Value


class GraphBuilder:
    """A graph in the making; names of values are what its methods take and return."""

    def __init__(self) -> None:
        self._nodes: list[Node] = []
        self._initialisers: dict[str, np.ndarray] = {}
        self._inputs: list[Value] = []
        self._outputs: list[Value] = []

    def input(self, name: str, dimensions: Dimensions, element: int = FLOAT) -> str:
        """A value that whoever runs the graph brings."""
        self._inputs.append(Value(name, element, dimensions))
        return name

    def output(self, name: str, value: str, dimensions: Dimensions) -> None:
        """A value that the graph gives, float32."""
        self._nodes.append(Node("Identity", (value,), (name,)))
        self._outputs.append(Value(name, FLOAT, dimensions))

    def initialiser(self, name: str, array: np.ndarray) -> str:
        """An array that is part of the graph, under a name that readers ask for."""
        self._initialisers[name] = array
        return name

    def floats(self, values: object) -> str:
        """A constant of float32."""
        return self._constant(np.asarray(values, np.float32))

    def integers(self, values: object) -> str:
        """A constant of int64."""
        return self._constant(np.asarray(values, np.int64))

    def _constant(self, array: np.ndarray) -> str:
        for name, other in self._initialisers.items():
            if name.startswith("constant_") and other.dtype == array.dtype and other.shape == array.shape:
                if other.tobytes() == array.tobytes():
                    return name
        return self.initialiser(f"constant_{len(self._initialisers)}", array)

    def add(self, op_type: str, *inputs: str, **attributes: int | tuple[int, ...]) -> str:
        """Result of an operator."""
        name = f"{op_type.lower()}_{len(self._nodes)}"
        self._nodes.append(Node(op_type, inputs, (name,), attributes))
        return name

    def reshape(self, value: str, sizes: Sequence[int]) -> str:
        """A value in another shape; 0 keeps a size, -1 is what is left."""
        return self.add("Reshape", value, self.integers(sizes))

    def clip(self, value: str, least: float, most: float, if_nan: float) -> str:
        """A float32 value within limits, and another instead of NaN."""
        cut = self.add("Clip", value, self.floats(least), self.floats(most))
        return self.add("Where", self.add("IsNaN", value), self.floats(if_nan), cut)

    def graph(self, name: str, doc: str) -> Graph:
        """What has been made.

        Raises
        ------
        ValueError
            If nothing reads an initialiser: what a network has must count in its graph.
        """
        read = {value for node in self._nodes for value in node.inputs}
        if unread := self._initialisers.keys() - read:
            raise ValueError(f"nothing in the graph {name!r} reads {', '.join(sorted(unread))}")
        return Graph(
            name, tuple(self._nodes), dict(self._initialisers), tuple(self._inputs), tuple(self._outputs), doc
        )
