# SPDX-License-Identifier: GPL-3.0-or-later
"""Graphs built in Python, compiled, and run at points of a unit square."""

from __future__ import annotations

from typing import Any

import numpy as np

from engine.kernels.bsdf import load_tables
from engine.scene.description import Image, Link, Node, NodeGraph, Notice
from engine.shaders.compiled_program import ProgramSource
from engine.shaders.compiler import compile_programs
from engine.shaders.folding import stand_in_geometry
from engine.state.geometry import GeometryArrays
from engine.state.lanes import (
    POINT_LIGHT,
    POINT_NG,
    POINT_NS,
    POINT_P,
    POINT_RADIUS,
    POINT_RAY_FLAGS,
    POINT_RAY_LENGTH,
    POINT_TRIANGLE,
    POINT_U,
    POINT_V,
    POINT_WO,
    RAY_CAMERA,
    Closures,
    ShadePoints,
    allocate_closures,
    allocate_points,
)
from engine.state.shaders import MODE_CLOSURES, ShaderArrays, allocate_memory
from engine.wavefront.evaluate_shaders import evaluate_shaders


class Graph:
    """Builds a `NodeGraph`: `add` returns the node's index, `link` refers to an output of it."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []

    def add(self, kind: str, name: str = "", **properties: Any) -> int:
        inputs = properties.pop("inputs", {})
        self.nodes.append(Node(kind, name or f"{kind} {len(self.nodes)}", inputs, properties))
        return len(self.nodes) - 1

    def link(self, kind: str, output: str, **properties: Any) -> Link:
        """Add a node and refer to one of its outputs."""
        return Link(self.add(kind, **properties), output)

    def emit(self, color: Any, strength: Any = 1.0) -> NodeGraph:
        """The graph with `color` emitted."""
        inputs = {"Color": color, "Strength": strength}
        return self.surface(self.link("ShaderNodeEmission", "Emission", inputs=inputs))

    def surface(self, link: Link) -> NodeGraph:
        return NodeGraph(self.nodes, link)


def compile_one(
    graph: NodeGraph | None, images: list[Image] | None = None, **source: Any
) -> tuple[ShaderArrays, list[str], list[Notice]]:
    return compile_programs([ProgramSource("M", graph, **source)], images or [])


def square_points(uv: Any, radius: float = 0.0) -> ShadePoints:
    """Points at (u, v) of the unit square in z = 0 seen from above."""
    uv = np.atleast_2d(np.asarray(uv, np.float32))
    points = allocate_points(len(uv))
    x, y = uv[:, 0], uv[:, 1]
    lower = y <= x
    points.real[:, POINT_P : POINT_P + 2] = uv
    for column in (POINT_WO, POINT_NG, POINT_NS):
        points.real[:, column + 2] = 1.0
    points.real[:, POINT_U] = np.where(lower, x - y, x)
    points.real[:, POINT_V] = np.where(lower, y, y - x)
    points.real[:, POINT_RADIUS] = radius
    points.real[:, POINT_RAY_LENGTH] = 2.0
    points.integer[:, POINT_TRIANGLE] = np.where(lower, 0, 1)
    points.integer[:, POINT_RAY_FLAGS] = RAY_CAMERA
    points.integer[:, POINT_LIGHT] = -1
    return points


def run(
    shaders: ShaderArrays,
    points: ShadePoints | None = None,
    mode: int = MODE_CLOSURES,
    geometry: GeometryArrays | None = None,
) -> Closures:
    """Evaluate at all points (default: one, in the middle of the square)."""
    points = square_points((0.5, 0.25)) if points is None else points
    geometry = stand_in_geometry(8) if geometry is None else geometry
    count = len(points.real)
    closures = allocate_closures(count)
    lanes = np.arange(count, dtype=np.int32)
    evaluate_shaders(
        shaders, geometry, load_tables(), points, closures, lanes, count, allocate_memory(shaders), mode
    )
    return closures


def emitted(graph: NodeGraph, points: ShadePoints | None = None, images: list[Image] | None = None) -> np.ndarray:
    """What a graph emits at points: float32 (points, 3)."""
    shaders, _names, _notices = compile_one(graph, images)
    return run(shaders, points).emission[:, :3].copy()
