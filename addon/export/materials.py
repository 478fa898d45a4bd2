# SPDX-License-Identifier: GPL-3.0-or-later
"""Materials: their graphs, and which mesh attributes the graphs ask for."""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Any

import bpy

from engine.scene.attribute_names import GEOMETRY_ATTRIBUTES, PARTICLE, PARTICLE_OUTPUTS
from engine.scene.description import Link, Material, Node, NodeGraph
from engine.scene.digest import content_digest

from ..dispersion import dispersion_of
from ..versions import read_setting, uses_nodes
from .context import CachedMaterial, ExportContext, cycles_property
from .images import ImageExporter
from .nodes import GraphExporter

#: Inputs of a Principled Volume that name attributes.
_VOLUME_ATTRIBUTES = ("Density Attribute", "Color Attribute", "Temperature Attribute")
#: Attributes of curves and points that nodes read.
_CURVE_ATTRIBUTES = {
    "ShaderNodeHairInfo": ("curve_intercept", "curve_length", "curve_random"),
    "ShaderNodeBsdfHairPrincipled": ("curve_random",),
    "ShaderNodePointInfo": ("point_random",),
}


@dataclass(frozen=True)
class AttributeRequest:
    """What materials want to know about a mesh besides its shape and UV maps.

    `names` are attributes ('' the active colour), `tangents` UV maps ('' the active one), `properties` those of the
    object ("object:name") or of its instancer first ("instancer:name"); `generated` whether undeformed coordinates
    are of use, `instancer` whether those of the instancer are, `smooth` whether voxels matter further away than to the
    next, `displaces` whether a mesh is displaced. `elsewhere` are attributes of whatever rays of its nodes meet.
    """

    names: frozenset[str] = frozenset()
    tangents: frozenset[str] = frozenset()
    properties: frozenset[str] = frozenset()
    generated: bool = False
    instancer: bool = False
    smooth: bool = False
    displaces: bool = False
    elsewhere: frozenset[str] = frozenset()

    def __or__(self, other: AttributeRequest) -> AttributeRequest:
        return AttributeRequest(
            self.names | other.names,
            self.tangents | other.tangents,
            self.properties | other.properties,
            self.generated or other.generated,
            self.instancer or other.instancer,
            self.smooth or other.smooth,
            self.displaces or other.displaces,
            self.elsewhere | other.elsewhere,
        )


@dataclass
class MaterialExporter:
    """Collects materials in the order they are met."""

    context: ExportContext
    graphs: GraphExporter
    images: ImageExporter
    materials: list[Material] = field(default_factory=list)
    requests: list[Any] = field(default_factory=list)
    _indices: dict[int, int] = field(default_factory=dict)
    _default_volume: int = -1

    def index_of(self, material: bpy.types.Material | None, user: str) -> int:
        """Index into `materials`, -1 for an empty slot.

        Parameters
        ----------
        user : str
            An object that uses it, for notices.
        """
        if material is None:
            return -1
        address = material.original.as_pointer()
        if address not in self._indices:
            self._indices[address] = len(self.materials)
            kept = self._kept(material) or self._read(material, user)
            self.materials.append(kept.material)
            self.requests.append(kept.request)
        return self._indices[address]

    def default_volume(self) -> int:
        """Index of what a volume without a material is made of."""
        if self._default_volume < 0:
            named = {"Density Attribute": "density", "Temperature Attribute": "temperature"}
            node = Node("ShaderNodeVolumePrincipled", "Principled Volume", named)
            graph = NodeGraph([node], volume=Link(0, "Volume"))
            self._default_volume = len(self.materials)
            self.materials.append(Material("default volume", "default volume", graph))
            self.requests.append(attribute_request(graph))
        return self._default_volume

    @property
    def _state(self) -> Hashable:
        """What materials depend on besides datablocks that say that they have changed."""
        context = self.context
        scene = context.scene
        return (
            scene.frame_current + scene.frame_subframe, context.working_space, tuple(context.aovs.items()),
            context.view_layer.name,
        )  # fmt: skip

    def _kept(self, material: bpy.types.Material) -> CachedMaterial | None:
        """What was read of a material before, if nothing of it can have changed; its images come in where they were."""
        context = self.context
        kept = context.cache.materials.get(material.name_full)
        if kept is None or kept.reads is None or kept.state != self._state or not context.are_untouched(kept.reads):
            return None
        if any(self.images.take_over(identity) != index for identity, index in kept.images):
            return None
        context.notice_again(kept.notices)
        return kept

    def _read(self, material: bpy.types.Material, user: str) -> CachedMaterial:
        context = self.context
        noticed, met = len(context.notices), len(self.images.met)
        exported = self._export(material, user)
        has_nodes = uses_nodes(material)
        reads = {material.original.as_pointer(), *(self.graphs.reads if has_nodes else ())}
        kept = context.cache.materials[material.name_full] = CachedMaterial(
            exported,
            replace(
                attribute_request(exported.graph, has_smooth_voxels=exported.has_smooth_voxels),
                displaces=displaces(exported),
            ),
            None if has_nodes and self.graphs.reads_more else frozenset(reads),
            tuple(self.images.met[met:]),
            tuple(context.notices[noticed:]),
            self._state,
        )
        return kept

    def _export(self, material: bpy.types.Material, user: str) -> Material:
        context = self.context
        if uses_nodes(material):
            graph = self.graphs.export(material.node_tree, f"{user} / {material.name}")
        else:
            graph = _plain_graph(material)
        subject = f"{user} / {material.name}"
        dispersion = dispersion_of(material, graph, partial(context.notice, subject))
        exported = Material(
            key=None,
            name=material.name,
            graph=graph,
            pass_index=material.pass_index,
            use_bump_map_correction=cycles_property(material, "use_bump_map_correction", True),
            use_transparent_shadow=bool(read_setting(material, "use_transparent_shadow")),
            has_smooth_voxels=_has_smooth_voxels(material, graph),
            emission_sampling=_emission_sampling(material),
            displacement_method=_displacement_method(material, graph),
            dispersion=context.finite(dispersion, 0.0, f"Material {material.name}", "Dispersion"),
            user=user,
        )
        exported.key = (material.name_full, fingerprint(exported))
        kept = context.cache.materials.get(material.name_full)
        if kept is not None and kept.material.key == exported.key:
            return kept.material
        return exported


def fingerprint(material: Material) -> str:
    """A digest of everything a material says; who has it does not count."""
    return content_digest(material, ("key", "user"))


def attribute_request(graph: NodeGraph | None, *, has_smooth_voxels: bool = False) -> AttributeRequest:
    """The attributes the nodes of a graph read."""
    names: set[str] = set()
    tangents: set[str] = set()
    properties: set[str] = set()
    elsewhere: set[str] = set()
    generated = instancer = False
    linked = _linked_outputs(graph) if graph is not None else set()
    for index, node in enumerate(graph.nodes if graph is not None else ()):
        if node.kind == "ShaderNodeAttribute":
            kind = node.properties.get("attribute_type", "GEOMETRY")
            if kind == "GEOMETRY":
                names.add(node.properties["attribute_name"])
            elif kind in ("OBJECT", "INSTANCER"):
                properties.add(f"{kind.lower()}:{node.properties['attribute_name']}")
        elif node.kind == "ShaderNodeRaycast":
            elsewhere.update(name for _output, name, _type in node.properties.get("attributes", ()))
        elif node.kind == "ShaderNodeVolumePrincipled":
            names.update(str(name) for key in _VOLUME_ATTRIBUTES if (name := node.inputs.get(key)))
        elif node.kind == "ShaderNodeVolumeInfo":
            names.update(("density", "color", "flame", "temperature"))
        elif node.kind in _CURVE_ATTRIBUTES:
            names.update(_CURVE_ATTRIBUTES[node.kind])
            if node.properties.get("model") == "HUANG":
                names.add("curve_normal")
        elif node.kind == "ShaderNodeNewGeometry":
            names.update(name for output, name in GEOMETRY_ATTRIBUTES.items() if (index, output) in linked)
        elif node.kind == "ShaderNodeParticleInfo":
            properties.update(f"{PARTICLE}{output}" for output in PARTICLE_OUTPUTS if (index, output) in linked)
        elif node.kind == "ShaderNodeVertexColor":
            names.add(node.properties["layer_name"])
        elif node.kind == "ShaderNodeNormalMap" and node.properties["space"] == "TANGENT":
            tangents.add(node.properties["uv_map"])
        elif node.kind == "ShaderNodeVectorDisplacement" and node.properties["space"] == "TANGENT":
            tangents.add("")
        elif node.kind == "ShaderNodeTangent" and node.properties["direction_type"] == "UV_MAP":
            tangents.add(node.properties["uv_map"])
        elif node.kind == "ShaderNodeTangent":
            generated = True
        elif node.kind == "ShaderNodeTexCoord" and (index, "Generated") in linked:
            generated = True
        elif node.kind.startswith("ShaderNodeTex") and node.kind != "ShaderNodeTexCoord":
            generated = generated or "Vector" not in node.inputs
        elif node.kind in ("ShaderNodeBsdfPrincipled", "ShaderNodeBsdfAnisotropic"):
            generated = generated or _is_anisotropic(node)
        if node.kind in ("ShaderNodeTexCoord", "ShaderNodeUVMap") and node.properties.get("from_instancer"):
            instancer = True
    return AttributeRequest(
        frozenset(names), frozenset(tangents), frozenset(properties), generated, instancer, has_smooth_voxels,
        elsewhere=frozenset(elsewhere),
    )


def _linked_outputs(graph: NodeGraph) -> set[tuple[int, str]]:
    links = [graph.surface, graph.volume, graph.displacement]
    for node in graph.nodes:
        links.extend(value for value in node.inputs.values() if isinstance(value, Link))
    return {(link.node, link.output) for link in links if link is not None}


def _is_anisotropic(node: Node) -> bool:
    """Whether the default tangent, which circles Generated coordinates, is used."""
    strength = node.inputs.get("Anisotropic", node.inputs.get("Anisotropy", 0.0))
    return strength != 0.0 and "Tangent" not in node.inputs


def _plain_graph(material: bpy.types.Material) -> NodeGraph:
    """A material without nodes is diffuse in its viewport colour, as in Cycles."""
    color = (*material.diffuse_color[:3], 1.0)
    node = Node("ShaderNodeBsdfDiffuse", "Diffuse BSDF", {"Color": color, "Roughness": 0.0})
    return NodeGraph([node], surface=Link(0, "BSDF"))


def _has_smooth_voxels(material: bpy.types.Material, graph: NodeGraph | None) -> bool:
    """Whether what is inside interpolates voxels by cubic splines."""
    has_volume = graph is not None and graph.volume is not None
    return has_volume and cycles_property(material, "volume_interpolation", "LINEAR") == "CUBIC"


def displaces(material: Material) -> bool:
    """Whether a material moves vertices."""
    return material.displacement_method != "BUMP"


def _displacement_method(material: bpy.types.Material, graph: NodeGraph | None) -> str:
    """What becomes of a displacement, where there is one; Blender and Cycles had different names for it."""
    if graph is None or graph.displacement is None:
        return "BUMP"
    method = str(read_setting(material, "displacement_method"))
    return "DISPLACEMENT" if method == "TRUE" else method


def _emission_sampling(material: bpy.types.Material) -> str:
    """What newer Blenders have five ways for was one switch before."""
    method = read_setting(material, "cycles.emission_sampling")
    if method is not None:
        return method
    return "AUTO" if cycles_property(material, "sample_as_light", True) else "NONE"
