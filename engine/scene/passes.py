# SPDX-License-Identifier: GPL-3.0-or-later
"""What passes depend on besides what is seen: which are filled by materials, and what moves between frames."""

from __future__ import annotations

from dataclasses import dataclass, field

from engine.array_types import Float32Array


@dataclass(frozen=True)
class Aov:
    """A pass that materials and the world fill by their AOV Output nodes: its name, and whether colour or value."""

    name: str
    is_color: bool


@dataclass
class PassMotion:
    """What moves between the frame before and the frame after, for motion vectors.

    Attributes
    ----------
    camera : float32 (2, 4, 4) or None
        Camera to world; None: it stands still.
    lens : float32 (2, 3) or None
        `Camera.lens`, `sensor_width` and `sensor_height` of a perspective camera; None: it does not zoom.
    instances : dict of float32 (2, 4, 4)
        Object to world, by index of the instance.
    shapes : dict of float32 (2, V, 3)
        Vertices, by index of the mesh.
    """

    camera: Float32Array | None = None
    lens: Float32Array | None = None
    instances: dict[int, Float32Array] = field(default_factory=dict)
    shapes: dict[int, Float32Array] = field(default_factory=dict)


@dataclass
class PassSettings:
    """What passes of data depend on besides the scene.

    Attributes
    ----------
    alpha_threshold : float
        Passes of one surface show the first of at least this alpha.
    mist_start, mist_depth : float  [m]
    mist_falloff : float
        Exponent of the mist's share of the way.
    occlusion_distance : float  [m]
        How far the Ambient Occlusion pass looks.
    background_moves : bool
        Whether the background has motion vectors.
    looks_up_transmission : bool
        Whether what rough glass lets through is looked up like what it reflects, for passes of colour and denoisers;
        otherwise the glass counts as smooth.
    follows_mirrors : bool
        Whether denoisers' specular albedo and roughness behind a surface count by what it mirrors, too, besides what
        it lets through.
    weighs_by_roughness : bool
        Whether denoisers' specular albedo is of lobes in so far as they are mirrors; otherwise of all glossy ones and
        of glass.
    motion : PassMotion or None
        None: everything stands still.
    """

    alpha_threshold: float = 0.5
    mist_start: float = 0.0
    mist_depth: float = 100.0
    mist_falloff: float = 1.0
    occlusion_distance: float = 10.0
    background_moves: bool = False
    looks_up_transmission: bool = False
    follows_mirrors: bool = True
    weighs_by_roughness: bool = True
    aovs: tuple[Aov, ...] = ()
    motion: PassMotion | None = None
