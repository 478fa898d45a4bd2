# SPDX-License-Identifier: GPL-3.0-or-later
"""What a host hands to the engine: plain data, no Blender type, in Blender's own units and conventions.

World space is right-handed with z up; matrices are float32 (4, 4), object to world, acting on column vectors; colours
are linear in the scene's working space (Rec.709 unless the host says otherwise); row 0 of an image is its bottom.
`engine.builder.scene` validates a `SceneDescription` and flattens it into the arrays that kernels read.
"""

from __future__ import annotations

from collections.abc import Hashable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.array_types import Float32Array, Int32Array, Uint32Array
from engine.scene.bake import Bake
from engine.scene.dicing import Dicing
from engine.scene.fast_gi import FastGi
from engine.scene.grids import Grid, VolumeMotion
from engine.scene.image import Image
from engine.scene.linking import Linking
from engine.scene.panorama import Panorama, StereoEye
from engine.scene.passes import PassSettings
from engine.scene.rounds import Rounds

# Visibility of an instance, a light or the world to kinds of rays (bits of `visibility`).
VISIBLE_CAMERA = 1
VISIBLE_DIFFUSE = 2
VISIBLE_GLOSSY = 4
VISIBLE_TRANSMISSION = 8
VISIBLE_VOLUME = 16
VISIBLE_SHADOW = 32
VISIBLE_ALL = 63
VISIBLE_RAYCAST = 1 << 24  # to Raycast nodes, whose rays are none of light


@dataclass(frozen=True)
class Notice:
    """Something that could not be exported as it is, and what was done instead.

    `subject` names the object, material and node ("Cube / Glass / Wave Texture"), `problem` what is not supported,
    `fallback` what the picture shows instead. Reported once each at the end of export.
    """

    subject: str
    problem: str
    fallback: str


# Materials: a host-neutral node graph, compiled by `engine.shaders.compiler`.


@dataclass(frozen=True)
class Link:
    """Reference to output `output` (socket identifier) of node `node` (index into `NodeGraph.nodes`).

    `otherwise` is the linked socket's own value, which counts where nothing is known of that node or output; None: the
    surface supplies it, or there is none.
    """

    node: int
    output: str
    otherwise: Any = None


@dataclass
class Node:
    """One node: groups, reroutes, frames and muted nodes are already resolved by the host.

    Attributes
    ----------
    kind : str
        The host's node type, such as `'ShaderNodeBsdfPrincipled'`.
    name : str
        Shown in messages.
    inputs : dict
        Socket identifier to `Link`, or to its unlinked value: float, or tuple of 3 or 4 floats, int, bool or str.
        A socket of type vector that is unlinked and takes a default from the surface (Normal, texture coordinates)
        is absent. A socket identifier is Blender 5.2's `socket.identifier` (older hosts translate).
    properties : dict
        The node's own settings by their RNA names (`operation`, `blend_type`, `interpolation`, ...); images as an
        index into `SceneDescription.images` under `'image'` (-1 = missing). Ramps as a float32 table `'ramp'` (257, 4)
        over [0, 1], with `'interpolate'` (False = constant steps). Curves as `'curves'`, (257, 3) for colours (the
        combined curve first, then each channel's) and vectors, (257, 1) for Float Curve, sampled evenly from
        `'min_x'` to `'max_x'` (the extent of all curves), with `'extrapolate'`. What RGB, Value and Normal nodes hold
        is `'value'`, as is the resolved value (4 floats) of a view layer's attribute. `'object_matrix'` float32
        (4, 4), world to object, of a Texture Coordinate node with an object. `'wraps_scaled'` of a Magic Texture:
        coordinates are wrapped after scaling (True where it is missing). `'has_unit_frame'` of a Normal Map: the
        normal between those of the corners is normalised (likewise). `'tints_by_bounce'` of a Diffuse or Principled
        BSDF: facets of rough diffuse surfaces tint light as from Blender 5.3 on, and glass of the latter is as
        anisotropic as what it reflects, its thin walls as rough as there (likewise). `'seconds'` and `'frame'` of a
        Scene Time.
        `'is_conversion'` of an Emission that is no node of the host's but what a linked colour becomes on a shader
        socket.
    changed : frozenset of str
        Names of inputs and properties whose value is not that of a new node. Only hosts that may have more than the
        engine knows fill it in: the engine reports those of them that it does not know.
    """

    kind: str
    name: str
    inputs: dict[str, Any] = field(default_factory=dict)
    properties: dict[str, Any] = field(default_factory=dict)
    changed: frozenset[str] = frozenset()


@dataclass
class NodeGraph:
    """A material's, light's or world's nodes. `surface` is None where nothing is linked to the output."""

    nodes: list[Node] = field(default_factory=list)
    surface: Link | None = None
    volume: Link | None = None
    displacement: Link | None = None
    #: Indices of AOV Output nodes, of those AOVs that are asked for.
    aovs: list[int] = field(default_factory=list)


@dataclass
class Material:
    """A surface material. `key` is stable between frames; `graph` None means Blender's default grey diffuse.

    `user` names an object that has it, for messages.
    """

    key: Hashable
    name: str
    graph: NodeGraph | None
    pass_index: int = 0
    use_bump_map_correction: bool = True
    use_transparent_shadow: bool = True
    #: Whether voxels are interpolated by cubic splines, not by straight lines.
    has_smooth_voxels: bool = False
    #: 'AUTO', 'NONE', 'FRONT', 'BACK', 'FRONT_BACK': whether emission is sampled as a light.
    emission_sampling: str = "AUTO"
    #: How its refractive indices change with the wavelength [um^2], 0 not at all; `engine.spectral.dispersion`.
    dispersion: float = 0.0
    #: 'BUMP', 'DISPLACEMENT' or 'BOTH': whether the graph's displacement bends normals, moves vertices, or does both.
    displacement_method: str = "BUMP"
    user: str = ""


# Geometry


@dataclass
class Attribute:
    """Values on a mesh. `domain` is 'POINT', 'FACE' (triangle) or 'CORNER' (3 per triangle).

    data : float32, shape (vertices | triangles | 3 * triangles, 1..4)
    """

    domain: str
    data: Float32Array


@dataclass
class Mesh:
    """Triangles in object space, shared by any number of instances.

    Attributes
    ----------
    key : hashable
        Changes whenever the content does; equal keys in two frames mean nothing needs rebuilding.
    vertices : float32 (V, 3)
    triangles : uint32 (T, 3)
    corner_normals : float32 (T, 3, 3) or None
        Unit split normals; None where every face is flat.
    material_slots : int32 (T,), index into the material list of the instance
    attributes : dict
        By name; UV maps are `CORNER` attributes of width 2, tangents for map `X` are `'X.tangent'`, width 4
        (`'.tangent'` for the render-active map where a node names none). `'standard:name'` is what Cycles has under a
        name of its own ('standard:N'). Names of the engine's own are in `engine.scene.attribute_names`.
    default_uv, default_color : str
        Names of the render-active UV map and colour attribute, '' if none.
    texture_space : float32 (2, 3)
        Centre and half size of Blender's texture space, for Generated coordinates.
    motion_vertices : float32 (S, V, 3) or None
        Vertices at S evenly spaced times from the shutter's opening to its closing, two or more; None: always the same.
    motion_normals : float32 (S, T, 3, 3) or None
        `corner_normals` at these times; None where every face is flat.
    grids : dict
        Voxels of a volume, by the name that Attribute nodes have for them; the triangles are a box around them.
    volume_motion : VolumeMotion or None
        How what is in `grids` moves while the shutter is open; the box is around all of it.
    dicing : Dicing or None
    rounds : Rounds or None
        What `triangles` are where they are none: segments of curves, or spheres.
    """

    key: Hashable
    name: str
    vertices: Float32Array
    triangles: Uint32Array
    corner_normals: Float32Array | None
    material_slots: Int32Array
    attributes: dict[str, Attribute] = field(default_factory=dict)
    default_uv: str = ""
    default_color: str = ""
    texture_space: Float32Array | None = None
    motion_vertices: Float32Array | None = None
    motion_normals: Float32Array | None = None
    grids: dict[str, Grid] = field(default_factory=dict)
    volume_motion: VolumeMotion | None = None
    dicing: Dicing | None = None
    rounds: Rounds | None = None


@dataclass
class Instances:
    """Every appearance of a mesh, structure of arrays, N instances."""

    mesh: Int32Array  # (N,) index into SceneDescription.meshes
    transform: Float32Array  # (N, 4, 4) object to world
    material_offset: Int32Array  # (N,) first entry in `materials` for this instance; slots follow
    materials: Int32Array  # indices into SceneDescription.materials, -1 = default material
    visibility: Uint32Array  # (N,) VISIBLE_* bits, VISIBLE_RAYCAST among them
    pass_index: Int32Array  # (N,) object index pass
    random: Float32Array  # (N,) in [0, 1): Object Info > Random
    color: Float32Array  # (N, 4) object colour, linear
    is_holdout: npt.NDArray[np.bool_]  # (N,)
    name: list[str]  # (N,) object names, for messages
    #: (N, 3) Generated and UV coordinates of the instancer (particles, geometry nodes), zero elsewhere.
    dupli_generated: Float32Array
    dupli_uv: Float32Array  # (N, 2)
    #: (N,) Blender's Shadow Terminator Offsets, None = 0 for all. Geometry: cosine below which shadow rays start off a
    #: smooth surface. Shading: in [0, 1].
    terminator_offset: Float32Array | None = None
    shading_offset: Float32Array | None = None
    #: By index, for instances that move while the shutter is open: object to world at evenly spaced times from its
    #: opening to its closing, float32 (S, 4, 4), two or more. `transform` is that at the middle.
    motion: dict[int, Float32Array] = field(default_factory=dict)
    #: (N,) names of the topmost parents, for the Cryptomatte of assets; None = `name`.
    asset: list[str] | None = None
    #: (N,) index into `SceneDescription.light_groups` of what they emit, -1 = none; None = -1 for all.
    light_group: Int32Array | None = None
    is_shadow_catcher: npt.NDArray[np.bool_] | None = None  # (N,); None = none
    #: (N,) factor on the density of media inside that vary (volumes that grow thinner with their size); None = 1.
    medium_density: Float32Array | None = None
    #: (N,) how far short rays look that leave it (`FastGi`) [m], 0 = as far as others; None = 0 for all.
    occlusion_distance: Float32Array | None = None
    #: (N, 4) each: what Attribute nodes read of objects and their instancers, by 'object:name' and 'instancer:name'.
    properties: dict[str, Float32Array] = field(default_factory=dict)

    @property
    def has_catchers(self) -> bool:
        """Whether there are shadow catchers."""
        return self.is_shadow_catcher is not None and bool(self.is_shadow_catcher.any())


# Lights: Blender's units; engine.builder.lamps converts.


@dataclass
class Light:
    """A light object.

    Attributes
    ----------
    kind : str
        'POINT', 'SPOT', 'SUN' or 'AREA'.
    transform : float32 (4, 4)
        Local -z is the direction of emission.
    color : tuple of 3 floats
        Linear, temperature and exposure already multiplied in.
    temperature : float
        [K] of the black body that `color` is the colour of; 0: of none.
    energy : float
        [W], or [W m^-2] for suns.
    is_normalized : bool
        False: `energy` does not shrink as the light grows (Blender 4.5's "Normalize" unchecked).
    radius : float
        [m] soft size of points and spots.
    angle : float
        [rad] angular diameter of suns.
    spot_angle, spot_blend : float
        [rad] full cone angle, and blend in [0, 1].
    shape : str
        Area: 'SQUARE', 'RECTANGLE', 'DISK' or 'ELLIPSE', of `size_x` by `size_y` [m] before the transform.
    spread : float
        [rad] area: pi = all directions.
    graph : NodeGraph or None
        Emission multiplies the light's strength; None = plain.
    random, object_color, pass_index : of the object, for its graph: in [0, 1); linear, with alpha
    """

    key: Hashable
    name: str
    kind: str
    transform: Float32Array
    color: tuple[float, float, float]
    energy: float
    is_normalized: bool = True
    radius: float = 0.0
    angle: float = 0.0
    spot_angle: float = 0.785
    spot_blend: float = 0.15
    shape: str = "SQUARE"
    size_x: float = 1.0
    size_y: float = 1.0
    spread: float = float(np.pi)
    use_soft_falloff: bool = True
    cast_shadow: bool = True
    use_mis: bool = True
    max_bounces: int = 1024
    visibility: int = VISIBLE_ALL
    graph: NodeGraph | None = None
    random: float = 0.0
    object_color: tuple[float, float, float, float] = (1.0, 1.0, 1.0, 1.0)
    pass_index: int = 0
    temperature: float = 0.0
    light_group: int = -1  # index into `SceneDescription.light_groups`, -1 = none; so of the world


@dataclass
class Portal:
    """An opening that the background shines through: rays are sent through it, it emits nothing and hides nothing.

    transform, shape, size_x, size_y : as of `Light`, of an area lamp
    """

    transform: Float32Array
    shape: str
    size_x: float
    size_y: float


@dataclass
class World:
    """Background. `color` is used where `graph` is None."""

    key: Hashable
    name: str
    graph: NodeGraph | None
    color: tuple[float, float, float] = (0.05, 0.05, 0.05)
    visibility: int = VISIBLE_ALL & ~VISIBLE_SHADOW
    #: 'AUTOMATIC', 'MANUAL' or 'NONE': how the world is importance sampled, and the map's width when manual.
    sampling: str = "AUTOMATIC"
    map_resolution: int = 1024
    max_bounces: int = 1024
    #: False: what is sampled of it shines through everything.
    cast_shadow: bool = True
    light_group: int = -1
    portals: list[Portal] = field(default_factory=list)


# Camera and frame


@dataclass
class Camera:
    """Blender's camera; `engine.builder.camera` turns it into rays as Cycles does.

    transform : float32 (4, 4), camera to world, looking along local -z, without scale.
    """

    kind: str = "PERSP"  # 'PERSP', 'ORTHO' or 'PANO'
    transform: Float32Array = field(default_factory=lambda: np.eye(4, dtype=np.float32))
    lens: float = 50.0  # [mm]
    sensor_width: float = 36.0  # [mm]
    sensor_height: float = 24.0  # [mm]
    sensor_fit: str = "AUTO"  # 'AUTO', 'HORIZONTAL' or 'VERTICAL'
    ortho_scale: float = 6.0  # [m]
    shift_x: float = 0.0
    shift_y: float = 0.0
    clip_start: float = 0.1
    clip_end: float = 1000.0
    use_dof: bool = False
    focus_distance: float = 10.0  # [m]
    aperture_fstop: float = 2.8
    aperture_blades: int = 0
    aperture_rotation: float = 0.0  # [rad]
    aperture_ratio: float = 1.0
    #: Of the kind 'PANO'.
    panorama: Panorama = field(default_factory=Panorama)
    #: Of an eye of spherical stereo.
    eye: StereoEye | None = None
    #: Camera to world at evenly spaced times of the shutter, float32 (S, 4, 4); None: it stands still.
    motion: Float32Array | None = None
    #: `lens`, `sensor_width` and `sensor_height` at the shutter's opening and closing, float32 (2, 3); None: always
    #: those of the middle. Of perspective cameras: others do not zoom, as in Cycles.
    lens_motion: Float32Array | None = None


@dataclass
class Frame:
    """The image: `width` x `height` full pixels, of which the engine renders the region (x0, y0, x1, y1).

    y counts from the bottom. Without a border the region is the whole image.
    """

    width: int
    height: int
    region: tuple[int, int, int, int]
    pixel_aspect_x: float = 1.0
    pixel_aspect_y: float = 1.0
    exposure: float = 1.0  # film exposure: a factor on radiance


@dataclass
class SceneDescription:
    """One view layer at one frame."""

    camera: Camera
    frame: Frame
    meshes: list[Mesh]
    instances: Instances
    materials: list[Material]
    images: list[Image]
    lights: list[Light]
    world: World | None
    notices: list[Notice] = field(default_factory=list)
    working_space: str = "Rec.709"
    #: 3x3 from the working space to CIE XYZ (D65), for blackbody and luminance; None means Rec.709.
    to_xyz: Float32Array | None = None
    frame_current: float = 0.0
    #: When the shutter opens and closes [frames]; None: it takes no time, at `frame_current`.
    shutter: tuple[float, float] | None = None
    #: How far the shutter is open at evenly spaced times, float32 (K,), 0 or more; None: open all the time.
    shutter_curve: Float32Array | None = None
    #: Share of the shutter's time in which a row of the image is exposed, 0 to 1, of the top row the first part and of
    #: the bottom row the last; 1: all rows all the time.
    rolling_shutter_duration: float = 1.0
    passes: PassSettings = field(default_factory=PassSettings)
    light_groups: tuple[str, ...] = ()  # names of the view layer's
    fast_gi: FastGi = field(default_factory=FastGi)
    asks_for_caustics: bool = False  # light that comes over smooth surfaces is to be sharp, whatever Filter Glossy says
    bake: Bake | None = None  # what is looked at instead of what the camera sees; `frame` is of its size
    linking: Linking | None = None  # None: every emitter lights everything, and all casts shadows in its light

    @property
    def is_moving(self) -> bool:
        """Whether anything moves while the shutter is open but the camera: light at a place depends on the time."""
        return bool(self.instances.motion) or any(
            mesh.motion_vertices is not None or mesh.volume_motion is not None for mesh in self.meshes
        )

    @property
    def has_dispersion(self) -> bool:
        """Whether some material refracts wavelengths differently."""
        return any(material.dispersion != 0.0 for material in self.materials)
