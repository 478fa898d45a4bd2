# SPDX-License-Identifier: GPL-3.0-or-later
"""Small scenes of lights, and kernels that draw from them in bulk, for the tests of light sampling."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from engine.builder.emission import ProgramInfo
from engine.builder.environment import EnvironmentMap, build_environment_map
from engine.builder.geometry import build_geometry
from engine.builder.lights import build_lights
from engine.kernels.binary_tree import GRID_SIDE, LEAF
from engine.kernels.constants import DISTANT
from engine.kernels.lights import (
    Receiver,
    background_pdf,
    distant_lamp_is_hit,
    distant_lamp_leaving,
    distant_lamp_pdf,
    lamp_hit,
    lamp_leaving,
    lamp_pdf,
    sample_light,
    triangle_emitter_pdf,
)
from engine.kernels.lights.linking import tree_of_emitter
from engine.kernels.lights.tree import emitter_pmf, pick_emitter, selection_row
from engine.runtime.jit import kernel
from engine.scene.description import Camera, Frame, Light, Mesh, SceneDescription, World
from engine.scene.instances import empty_instances, plain_instances
from engine.state.geometry import GeometryArrays
from engine.state.lights import (
    HEADER_FIRST_DISTANT,
    HEADER_HITTABLE,
    HEADER_LAST_DISTANT,
    LAMP_RADIANCE,
    TRIANGLE_RADIANCE,
    LightArrays,
    LightSelection,
)

# Columns of what `draw` writes.
PDF, EMITTER, WI, DISTANCE, RADIANCE, NG, PROGRAM, USE_MIS, POINT, U, V, INSTANCE, TRIANGLE = (
    0, 1, 2, 5, 6, 9, 12, 13, 14, 17, 18, 19, 20,
)  # fmt: skip
WIDTH = 21


def matrix(position: Any = (0.0, 0.0, 0.0), columns: Any = None) -> np.ndarray:
    """Object to world: linear part from its columns (images of x, y, z) and a position."""
    result = np.eye(4, dtype=np.float32)
    if columns is not None:
        result[:3, :3] = np.asarray(columns, np.float32).T
    result[:3, 3] = position
    return result


def lamp(kind: str, position: Any = (0.0, 0.0, 0.0), columns: Any = None, **values: Any) -> Light:
    """A lamp of 100 W (suns: 100 W m^-2), white, shining down."""
    settings = {"color": (1.0, 1.0, 1.0), "energy": 100.0, **values}
    return Light(key=kind, name=kind.title(), kind=kind, transform=matrix(position, columns), **settings)


def emissive_scene(
    vertices: Any, triangles: Any, transforms: Any = (), emission: Any = (1.0, 1.0, 1.0), mode: int = 3
) -> tuple[SceneDescription, ProgramInfo]:
    """One mesh of one emissive material, an instance per transform."""
    description = make_description()
    description.meshes.append(
        Mesh("mesh", "Mesh", np.asarray(vertices, np.float32), np.asarray(triangles, np.uint32), None,
             np.zeros(len(triangles), np.int32))
    )  # fmt: skip
    description.instances = plain_instances(transforms if len(transforms) else [np.eye(4)])
    info = ProgramInfo(
        np.ones(1, np.bool_), np.ones(1, np.bool_), np.asarray([emission], np.float32), np.zeros(1, np.float32),
        np.full(1, mode, np.int32),
    )
    return description, info


def make_description(lights: Any = (), world: World | None = None) -> SceneDescription:
    """A scene of lamps only."""
    return SceneDescription(
        camera=Camera(), frame=Frame(8, 8, (0, 0, 8, 8)), meshes=[], instances=empty_instances(), materials=[],
        images=[], lights=list(lights), world=world,
    )  # fmt: skip


def no_programs() -> ProgramInfo:
    """Programs of a scene that has none."""
    return ProgramInfo(
        np.zeros(0, np.bool_), np.zeros(0, np.bool_), np.zeros((0, 3), np.float32), np.zeros(0, np.float32),
        np.zeros(0, np.int32),
    )


def build(
    description: SceneDescription, info: ProgramInfo | None = None, background: Any = None
) -> tuple[LightArrays, GeometryArrays]:
    """Lights and geometry of a description; `background` is a map, or radiance to make one of."""
    geometry = build_geometry(description, [], [])
    is_map = background is None or isinstance(background, EnvironmentMap)
    environment = background if is_map else build_environment_map(background)
    return build_lights(description, geometry, info or no_programs(), environment), geometry


@kernel
def _draw(lights, geometry, p, n, has_transmission, leaves_dim, time, u, out):
    for i in range(u.shape[0]):
        receiver = Receiver((p[i, 0], p[i, 1], p[i, 2]), (n[i, 0], n[i, 1], n[i, 2]), has_transmission, leaves_dim, 0)
        sample = sample_light(lights, geometry, receiver, time, u[i, 0], u[i, 1], u[i, 2])
        out[i, PDF] = sample.pdf
        out[i, EMITTER] = sample.emitter
        out[i, DISTANCE] = sample.distance
        for c in range(3):
            out[i, WI + c] = sample.wi[c]
            out[i, RADIANCE + c] = sample.radiance[c]
            out[i, NG + c] = sample.ng[c]
            out[i, POINT + c] = sample.point[c]
        out[i, PROGRAM] = sample.program
        out[i, USE_MIS] = sample.use_mis
        out[i, U] = sample.u
        out[i, V] = sample.v
        out[i, INSTANCE] = sample.instance
        out[i, TRIANGLE] = sample.triangle


def _rows(value: Any, count: int) -> np.ndarray:
    return np.ascontiguousarray(np.broadcast_to(np.asarray(value, np.float32), (count, 3)))


def stratified(count: int, seed: int) -> np.ndarray:
    """`count` points (rounded down to a square) of [0, 1)^3, jittered on a grid in the last two dimensions."""
    side = int(count**0.5)
    generator = np.random.default_rng(seed)
    u = generator.random((side * side, 3))
    cells = np.stack(np.meshgrid(np.arange(side), np.arange(side), indexing="ij"), -1).reshape(-1, 2)
    u[:, 1:] = (u[:, 1:] + cells) / side
    return np.minimum(u, 1.0 - 2.0**-24).astype(np.float32)


def draw(
    lights: LightArrays, geometry: GeometryArrays, p: Any, n: Any, u: np.ndarray, has_transmission: bool = False,
    time: float = 0.5, leaves_dim: bool = False,
) -> np.ndarray:
    """Samples of `sample_light`, float32 (N, WIDTH), for receivers `p`, `n` (one, or N), at a time of the shutter."""
    out = np.zeros((len(u), WIDTH), np.float32)
    _draw(lights, geometry, _rows(p, len(u)), _rows(n, len(u)), has_transmission, leaves_dim, np.float32(time), u, out)
    return out


def irradiance(samples: np.ndarray, n: Any) -> np.ndarray:
    """Monte Carlo estimates of irradiance, (N,), one a sample (first channel)."""
    pdf = samples[:, PDF].astype(np.float64)
    cosine = np.maximum(samples[:, WI : WI + 3] @ np.asarray(n, np.float64), 0.0)
    return np.where(pdf > 0.0, samples[:, RADIANCE] * cosine / np.where(pdf > 0.0, pdf, 1.0), 0.0)


class Hits(NamedTuple):
    """What rays find of a scene's only light, (N,) each.

    Attributes
    ----------
    pdf : float32 [sr^-1]
        With which `sample_light` proposes the direction.
    distance : float32 [m]
        DISTANT for suns and the background, -1 where nothing is met.
    radiance : float32
        First channel; of the background the factor on its program's emission.
    """

    pdf: np.ndarray
    distance: np.ndarray
    radiance: np.ndarray


@kernel
def _hits(lights, p, n, has_transmission, leaves_dim, directions, pdfs, distances, radiances):
    receiver = Receiver((p[0], p[1], p[2]), (n[0], n[1], n[2]), has_transmission, leaves_dim, 0)
    for i in range(directions.shape[0]):
        wi = (directions[i, 0], directions[i, 1], directions[i, 2])
        pdfs[i] = background_pdf(lights, 0, receiver.p, receiver.n, has_transmission, leaves_dim, wi)
        if pdfs[i] > 0.0:
            distances[i], radiances[i] = DISTANT, 1.0
        for row in range(lights.header[HEADER_HITTABLE]):
            t = lamp_hit(lights, row, receiver.p, wi, 0.0, 1e30)
            share = lamp_leaving(lights, row, receiver.p, wi)
            if t >= 0.0 and share > 0.0:
                pdfs[i] += lamp_pdf(lights, row, receiver, wi, t)
                distances[i], radiances[i] = t, share * lights.lamps[row, LAMP_RADIANCE]
        for row in range(lights.header[HEADER_FIRST_DISTANT], lights.header[HEADER_LAST_DISTANT]):
            share = distant_lamp_leaving(lights, row, receiver.p, wi)
            if distant_lamp_is_hit(lights, row, receiver.p, wi, 0.0) and share > 0.0:
                pdfs[i] += distant_lamp_pdf(lights, row, receiver, wi)
                distances[i], radiances[i] = DISTANT, share * lights.lamps[row, LAMP_RADIANCE]


def hits(
    lights: LightArrays, p: Any, n: Any, directions: np.ndarray, has_transmission: bool = False,
    leaves_dim: bool = False,
) -> Hits:
    """What rays from p along directions (N, 3) find of lamps or the background; of several lamps the density's sum."""
    real, count = np.float32, len(directions)
    found = Hits(np.zeros(count, real), np.full(count, -1.0, real), np.zeros(count, real))
    _hits(
        lights, np.asarray(p, real), np.asarray(n, real), has_transmission, leaves_dim, directions.astype(real), *found
    )
    return found


def hit_pdf(
    lights: LightArrays, p: Any, n: Any, directions: np.ndarray, has_transmission: bool = False,
    leaves_dim: bool = False,
) -> np.ndarray:
    """Density (N,) with which lamps or the background are proposed along directions (N, 3)."""
    return hits(lights, p, n, directions, has_transmission, leaves_dim).pdf


def triangle_hits(
    lights: LightArrays, geometry: GeometryArrays, corners: np.ndarray, p: Any, n: Any, directions: np.ndarray,
    has_transmission: bool = False,
) -> Hits:
    """As `hits`, of the only triangle of an emissive mesh; `corners`: its own, (3, 3), world space."""
    v0, v1, v2 = np.asarray(corners, np.float64)
    edge1, edge2 = v1 - v0, v2 - v0
    # Moller and Trumbore 1997.
    across = np.cross(directions, edge2)
    determinant = across @ edge1
    determinant = np.where(determinant == 0.0, np.nan, determinant)
    offset = np.asarray(p, np.float64) - v0
    beside = np.cross(offset, edge1)
    u, v = across @ offset / determinant, directions @ beside / determinant
    distance = beside @ edge2 / determinant
    is_hit = (u >= 0.0) & (v >= 0.0) & (u + v <= 1.0) & (distance > 0.0)
    asked = np.zeros((len(directions), WIDTH), np.float32)
    asked[:, WI : WI + 3] = directions
    asked[:, DISTANCE] = np.where(is_hit, distance, 1.0)
    pdf = np.where(is_hit, triangle_pdf(lights, geometry, asked, p, n, has_transmission), 0.0)
    return Hits(pdf, np.where(is_hit, distance, -1.0), np.where(is_hit, lights.triangles[0, TRIANGLE_RADIANCE], 0.0))


@kernel
def _triangle_pdf(lights, geometry, instances, triangles, p, n, has_transmission, time, wi, distance, out):
    for i in range(wi.shape[0]):
        direction = (wi[i, 0], wi[i, 1], wi[i, 2])
        receiver = Receiver((p[i, 0], p[i, 1], p[i, 2]), (n[i, 0], n[i, 1], n[i, 2]), has_transmission, False, 0)
        out[i] = triangle_emitter_pdf(
            lights, geometry, receiver, instances[i], triangles[i], direction, distance[i], time
        )


def triangle_pdf(
    lights: LightArrays, geometry: GeometryArrays, samples: np.ndarray, p: Any, n: Any, has_transmission: bool = False,
    time: float = 0.5,
) -> np.ndarray:
    """`triangle_emitter_pdf` of the points of emissive triangles in `samples`."""
    count = len(samples)
    out = np.zeros(count, np.float32)
    _triangle_pdf(
        lights, geometry, samples[:, INSTANCE].astype(np.int32), samples[:, TRIANGLE].astype(np.int32),
        _rows(p, count), _rows(n, count), has_transmission, np.float32(time),
        np.ascontiguousarray(samples[:, WI : WI + 3]),
        np.ascontiguousarray(samples[:, DISTANCE]), out,
    )  # fmt: skip
    return out


@kernel
def _pmfs(lights, p, n, has_transmission, out):
    for i in range(p.shape[0]):
        for emitter in range(out.shape[1]):
            at = (p[i, 0], p[i, 1], p[i, 2])
            row = selection_row(lights, tree_of_emitter(lights, emitter), at)
            out[i, emitter] = emitter_pmf(
                lights, row, emitter, at, (n[i, 0], n[i, 1], n[i, 2]), has_transmission
            )


def pmfs(lights: LightArrays, p: np.ndarray, n: np.ndarray, has_transmission: bool = False) -> np.ndarray:
    """Probability of every emitter, (N, E), for receivers (N, 3)."""
    out = np.zeros((len(p), len(lights.emitters)), np.float32)
    _pmfs(lights, _rows(p, len(p)), _rows(n, len(p)), has_transmission, out)
    return out


@kernel
def _picks(lights, tree, p, n, has_transmission, u, emitters, pmf):
    for i in range(u.shape[0]):
        at = (p[i, 0], p[i, 1], p[i, 2])
        emitters[i], pmf[i], _patch = pick_emitter(
            lights, selection_row(lights, tree, at), tree, at, (n[i, 0], n[i, 1], n[i, 2]), has_transmission, u[i]
        )


def picks(
    lights: LightArrays, p: Any, n: Any, u: np.ndarray, has_transmission: bool = False, tree: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Emitters chosen (-1 = none) and their probability, for random numbers (N,)."""
    emitters, pmf = np.zeros(len(u), np.int32), np.zeros(len(u), np.float32)
    _picks(lights, tree, _rows(p, len(u)), _rows(n, len(u)), has_transmission, u.astype(np.float32), emitters, pmf)
    return emitters, pmf


def with_selection(lights: LightArrays, probability: Any) -> LightArrays:
    """The same lights, clusters chosen with these probabilities (C,) wherever the receiver is within 100 m."""
    cumulative = np.concatenate([[0.0], np.cumsum(probability)]) / np.sum(probability)
    bounds = np.array([[-100.0] * 3, [100.0] * 3], np.float32)
    selection = LightSelection(
        np.zeros(1, np.float32), np.array([[LEAF, 0]], np.int32), bounds, np.zeros(GRID_SIDE**3, np.int32),
        np.full(3, GRID_SIDE / 200.0, np.float32), np.zeros(1, np.int32), cumulative[None].astype(np.float32),
    )  # fmt: skip
    return lights._replace(selection=selection)
