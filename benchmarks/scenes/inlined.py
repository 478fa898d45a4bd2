# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials with repeat zones, bundles and closures, which Blender resolves before a renderer sees them."""

from __future__ import annotations

from typing import Any

import bpy

from benchmarks.scenes.registry import scene
from benchmarks.scenes.studio import Nodes, Socket, add_object, lit_stage, material, sphere


def _repeat_zone(tree: Any, iterations: int, *items: tuple[str, str]) -> tuple[Any, Any]:
    """The two ends of a repeat zone with items of a socket type and name."""
    begin, end = tree.nodes.new("GeometryNodeRepeatInput"), tree.nodes.new("GeometryNodeRepeatOutput")
    begin.pair_with_output(end)
    end.repeat_items.clear()
    for kind, name in items:
        end.repeat_items.new(kind, name)
    begin.inputs["Iterations"].default_value = iterations
    return begin, end


def _rings(nodes: Nodes) -> Socket:
    """Waves of one more direction each time, summed up, with a colour that turns."""
    tree = nodes.tree
    begin, end = _repeat_zone(tree, 5, ("FLOAT", "Sum"), ("RGBA", "Tint"))
    begin.inputs["Sum"].default_value = 0.1
    begin.inputs["Tint"].default_value = (0.9, 0.3, 0.1, 1.0)
    place = nodes("TexCoord", output="Object")
    angle = nodes("Math", {"operation": "MULTIPLY"}, {0: begin.outputs["Iteration"], 1: 1.3})
    turned = nodes("VectorRotate", {"rotation_type": "Z_AXIS"}, Vector=place, Angle=angle)
    wave = nodes("TexWave", Vector=turned, Scale=1.7, output="Fac")
    share = nodes("Math", {"operation": "MULTIPLY"}, {0: wave, 1: 0.17})
    tree.links.new(nodes("Math", {"operation": "ADD"}, {0: begin.outputs["Sum"], 1: share}), end.inputs["Sum"])
    tree.links.new(nodes("HueSaturation", Hue=0.58, Color=begin.outputs["Tint"]), end.inputs["Tint"])
    color = nodes("HueSaturation", Value=end.outputs["Sum"], Color=end.outputs["Tint"])
    return nodes("BsdfDiffuse", Color=color)


def _bundled(nodes: Nodes) -> Socket:
    """A colour and a value that go through a bundle, the value through two."""
    tree = nodes.tree
    inner, outer = tree.nodes.new("NodeCombineBundle"), tree.nodes.new("NodeCombineBundle")
    inner.bundle_items.new("FLOAT", "Value")
    outer.bundle_items.new("RGBA", "Color")
    outer.bundle_items.new("BUNDLE", "More")
    inner.inputs["Value"].default_value = 0.35
    tree.links.new(nodes("TexChecker", Scale=6.0, Vector=nodes("TexCoord", output="Object")), outer.inputs["Color"])
    tree.links.new(inner.outputs[0], outer.inputs["More"])
    first, second = tree.nodes.new("NodeSeparateBundle"), tree.nodes.new("NodeSeparateBundle")
    first.bundle_items.new("BUNDLE", "More")
    first.bundle_items.new("RGBA", "Color")
    second.bundle_items.new("FLOAT", "Value")
    tree.links.new(outer.outputs[0], first.inputs[0])
    tree.links.new(first.outputs["More"], second.inputs[0])
    return nodes("BsdfGlossy", Color=first.outputs["Color"], Roughness=second.outputs["Value"])


def _closed(nodes: Nodes) -> Socket:
    """A closure that is evaluated twice, for two sizes of a pattern."""
    tree = nodes.tree
    begin, end = tree.nodes.new("NodeClosureInput"), tree.nodes.new("NodeClosureOutput")
    begin.pair_with_output(end)
    end.input_items.new("FLOAT", "Scale")
    end.output_items.new("RGBA", "Color")
    place = nodes("TexCoord", output="Object")
    tree.links.new(
        nodes("TexVoronoi", Scale=begin.outputs["Scale"], Vector=place, output="Color"), end.inputs["Color"]
    )

    def evaluated(scale: float) -> Socket:
        node = tree.nodes.new("NodeEvaluateClosure")
        node.input_items.new("FLOAT", "Scale")
        node.output_items.new("RGBA", "Color")
        tree.links.new(end.outputs[0], node.inputs["Closure"])
        node.inputs["Scale"].default_value = scale
        return node.outputs["Color"]

    return nodes(
        "MixShader",
        {},
        {1: nodes("BsdfDiffuse", Color=evaluated(2.0)), 2: nodes("BsdfDiffuse", Color=evaluated(7.0))},
        Fac=0.4,
    )


@scene("inlined-nodes")
def inlined_nodes() -> None:
    """A repeat zone, bundles within bundles, and a closure that is evaluated twice."""
    lit_stage()
    if bpy.app.version < (5, 0):
        return
    for k, surface in enumerate((_rings, _bundled, _closed)):
        name = surface.__name__.strip("_")
        add_object(name, sphere(name, material(name, surface), 0.6), (1.3 * (k - 1), -0.4, 0.6))
