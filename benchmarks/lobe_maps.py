# SPDX-License-Identifier: GPL-3.0-or-later
"""What a guiding method has learned at a point, and what it should have: densities over a map of directions.

A map is a latitude/longitude picture of the sphere in world space: row 0 looks down (-z), column 0 and the last one
along -y, the middle along +y, and x is to the right.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from engine.builder.scene import Scene
from engine.guiding.policy.guidance import Guidance
from engine.guiding.sampling.guide import eval_guide
from engine.guiding.sources import implementation
from engine.kernels.bsdf import eval_guided, rough_share
from engine.kernels.path import real_3
from engine.methods import SOURCES
from engine.render.batch import Batch
from engine.render.session import Session
from engine.render.tracer import Tracer
from engine.runtime.jit import kernel
from engine.scene.description import (
    VISIBLE_CAMERA,
    VISIBLE_DIFFUSE,
    VISIBLE_GLOSSY,
    Camera,
    Frame,
    Light,
    SceneDescription,
)
from engine.settings import RenderSettings
from engine.state.lanes import POINT_NG, POINT_NS, POINT_P, POINT_RAY_LENGTH, POINT_WO

Float32Array = npt.NDArray[np.float32]
Float64Array = npt.NDArray[np.float64]

#: Densities are averaged over so many directions a side of a cell, and over so many look-ups: trees and the mixture
#: field are looked up at a point drawn near the surface, and what paths follow is the mean of what is found.
_SIDE = 8
_LOOKUPS = 16
#: Part of every density that is uniform over the sphere when two are compared: a cell that a guide leaves out costs
#: a finite amount, as it does where the BSDF may propose it too.
FLOOR = 0.01
#: A ray out of a surface begins this far from it, relative to the distances around.
_NEAR = 1e-4
#: From the camera's axes to those of the map: it looks along +y, z is up.
_LOOKING_ALONG_Y = np.array(((1, 0, 0, 0), (0, 0, -1, 0), (0, 1, 0, 0), (0, 0, 0, 1)), np.float32)


def cell_angles(rows: int) -> Float64Array:
    """Solid angle of each cell of a map: float64 (rows, 2 * rows) [sr]."""
    heights = np.diff(np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1)))
    return np.repeat(heights[:, None] * np.pi / rows, 2 * rows, axis=1)


def cell_directions(rows: int, side: int = _SIDE) -> Float32Array:
    """Directions that divide each cell of a map into equal solid angles.

    Returns
    -------
    float32 (rows * 2 * rows, side * side, 3), unit, world space
    """
    edges = np.sin(np.linspace(-0.5 * np.pi, 0.5 * np.pi, rows + 1))
    within = (np.arange(side) + 0.5) / side
    z = edges[:-1, None] + np.diff(edges)[:, None] * within
    longitude = -np.pi + (np.arange(2 * rows)[:, None] + within) * (np.pi / rows)
    horizontal = np.sqrt(1.0 - z * z)[:, None, :, None]
    angle = longitude[None, :, None, :]
    x, y = horizontal * np.sin(angle), horizontal * np.cos(angle)
    z = np.broadcast_to(z[:, None, :, None], x.shape)
    return np.stack([x, y, z], axis=-1).reshape(rows * 2 * rows, side * side, 3).astype(np.float32)


@kernel
def _add_guide(guide, lane, directions, out):
    """Add to `out` a lane's density [sr^-1] by cell, mean over the cell's directions."""
    for cell in range(directions.shape[0]):
        total = 0.0
        for k in range(directions.shape[1]):
            wi = directions[cell, k, 0], directions[cell, k, 1], directions[cell, k, 2]
            total += eval_guide(guide, lane, wi)
        out[cell] += total / np.float32(directions.shape[1])


@kernel
def _fill_bsdf(closures, lane, points, directions, f_cos, out):
    """Write f |cos| of a lane's lobes that are not delta, mean over the cell's directions; `f_cos` is for one value."""
    wo, ng = real_3(points, lane, POINT_WO), real_3(points, lane, POINT_NG)
    for cell in range(directions.shape[0]):
        for c in range(out.shape[1]):
            out[cell, c] = 0.0
        for k in range(directions.shape[1]):
            wi = directions[cell, k, 0], directions[cell, k, 1], directions[cell, k, 2]
            eval_guided(closures, lane, wo, wi, ng, 0.5, f_cos, 0)
            for c in range(out.shape[1]):
                out[cell, c] += f_cos[0, c] / np.float32(directions.shape[1])


@dataclass(frozen=True)
class Surface:
    """The surface seen through a pixel's centre, world space.

    position, normal, wo : float32 (3,), the shading normal and the direction to the camera
    ray_length : float, distance to the camera [m]
    is_diffuse : bool, whether all rough lobes are
    f_cos : float32 (rows, 2 * rows, 3), map of BSDF times |cos| [sr^-1]
    """

    position: Float32Array
    normal: Float32Array
    wo: Float32Array
    ray_length: float
    is_diffuse: bool
    f_cos: Float32Array


def look(
    scene: Scene, settings: RenderSettings, guidance: Guidance | None, pixel: tuple[int, int], rows: int
) -> tuple[Surface, Float64Array]:
    """The surface at a pixel and the density that guided paths draw directions from there.

    Parameters
    ----------
    settings : RenderSettings
        Those that `guidance` was learned with.
    guidance : Guidance or None
        `RenderResult.guidance`.
    pixel : (int, int)
        Column and row of the image, row 0 at the bottom.

    Returns
    -------
    surface : Surface
    density : float64 (rows, 2 * rows) [sr^-1]
        Density of the guide alone, without the BSDF's share; 0 everywhere where paths are left to the BSDF
        because what was learned does not reach the point (the mixture field is asked first, whatever the method).

    Raises
    ------
    ValueError
        If there is no surface, or none that guiding applies to.
    """
    frame = scene.description.frame
    if not (0 <= pixel[0] < frame.width and 0 <= pixel[1] < frame.height):
        raise ValueError(f"pixel {pixel[0]} {pixel[1]}: the image is {frame.width} x {frame.height}")
    tracer = Tracer(scene, settings)
    tracer.guidance = guidance
    batch = Batch(scene.shaders, 1, settings, is_guided=True)
    # Networks are asked at the point itself.
    lookups = 1 if SOURCES[settings.source].is_network else _LOOKUPS
    lanes = tracer.look_at(batch, pixel, lookups)
    if len(lanes) == 0:
        raise ValueError("no surface is seen through the pixel: choose another")
    work, lane = batch.work, int(lanes[0])
    share, is_diffuse = rough_share(work.closures, lane, np.float32(0.0))
    if not share > 0.0:
        raise ValueError("the surface seen through the pixel scatters into single directions only: choose another")
    directions = cell_directions(rows)
    f_cos = np.zeros((rows * 2 * rows, 3), np.float32)
    _fill_bsdf(work.closures, lane, work.points, directions, np.zeros((1, 3), np.float32), f_cos)
    real = np.array(work.points.real[lane])
    surface = Surface(
        position=real[POINT_P : POINT_P + 3], normal=real[POINT_NS : POINT_NS + 3], wo=real[POINT_WO : POINT_WO + 3],
        ray_length=float(real[POINT_RAY_LENGTH]), is_diffuse=bool(is_diffuse),
        f_cos=f_cos.reshape(rows, 2 * rows, 3),
    )
    total = np.zeros(len(directions), np.float32)
    guided = [int(lane) for lane in lanes if work.guided.rough_share[lane] > 0.0]
    for lane in guided:
        _add_guide(batch.guidance.guide, lane, directions, total)
    return surface, total.reshape(rows, 2 * rows).astype(np.float64) / max(len(guided), 1)


def _seen_by(visibility: npt.NDArray[np.uint32] | int, kind: int) -> npt.NDArray[np.int64]:
    """Visibility to the camera taken from that to another kind of rays."""
    bits = np.asarray(visibility, np.int64)
    return np.where(bits & kind, bits | VISIBLE_CAMERA, bits & ~VISIBLE_CAMERA)


def panorama(description: SceneDescription, surface: Surface, rows: int) -> SceneDescription:
    """The scene as rays that the surface scatters see it: a map of incident radiance at its point."""
    kind = VISIBLE_DIFFUSE if surface.is_diffuse else VISIBLE_GLOSSY
    camera_matrix = _LOOKING_ALONG_Y.copy()
    camera_matrix[:3, 3] = surface.position
    near = _NEAR * (surface.ray_length + float(np.abs(surface.position).max()))
    world = description.world
    return replace(
        description,
        camera=Camera("PANO", camera_matrix, clip_start=near, clip_end=1e10),
        frame=Frame(2 * rows, rows, (0, 0, 2 * rows, rows)),
        instances=replace(
            description.instances, visibility=_seen_by(description.instances.visibility, kind).astype(np.uint32)
        ),
        lights=[replace(light, visibility=int(_seen_by(light.visibility, kind))) for light in description.lights],
        world=None if world is None else replace(world, visibility=int(_seen_by(world.visibility, kind))),
    )


def has_size(light: Light) -> bool:
    """Whether rays can meet a light, so that it can be found without light sampling."""
    return {"POINT": light.radius, "SPOT": light.radius, "SUN": light.angle}.get(light.kind, 1.0) > 0.0


def learning_settings(settings: RenderSettings, method: str, **changes: Any) -> RenderSettings:
    """Settings to learn with: guided to the end, and nothing that makes light look other than it is."""
    plain = {"time_limit": 0.0, "filter_glossy": 0.0, "clamp_direct": 0.0, "clamp_indirect": 0.0}
    return replace(
        settings, **{"guiding_method": method, "guiding_trial": False, "film_transparent": False, **plain, **changes}
    )


def _truth_settings(
    settings: RenderSettings, surface: Surface, lights: Sequence[Light], samples: int
) -> RenderSettings:
    """Settings of a panorama: what is left of the path after it was scattered at the surface.

    It is guided where that pays, which changes its noise only. So does sampling lights where rays meet all of them.
    """
    kind = "diffuse_bounces" if surface.is_diffuse else "glossy_bounces"
    left = {name: max(getattr(settings, name) - 1, 0) for name in ("max_bounces", kind)}
    return learning_settings(
        settings, "VMM", guiding_trial=True, samples=samples, pixel_filter="BOX",
        use_nee=settings.use_nee or all(has_size(light) for light in lights), **left,
    )


def trace_truth(
    description: SceneDescription, surface: Surface, settings: RenderSettings, samples: int
) -> list[Float64Array]:
    """Incident radiance at the surface, by path tracing: two independent maps, float64 (rows, 2 * rows, 3).

    Lights that are seen directly count whole. Below an opaque surface there is what its other side sees.

    Parameters
    ----------
    settings : RenderSettings
        Those of the methods: limits of paths, light sampling, seed and threads.
    samples : int
        Samples of each direction, in both maps together.
    """
    rows = surface.f_cos.shape[0]
    scene = panorama(description, surface, rows)
    settings = _truth_settings(settings, surface, description.lights, max(samples // 2, 1))
    session = Session(settings)
    session.load(scene)
    maps = []
    for seed in (settings.seed, settings.seed + 1):
        session.settings = replace(settings, seed=seed)
        maps.append(session.render().passes["Combined"][..., :3].astype(np.float64))
    session.close()
    return maps


def targets(radiance: Float64Array, surface: Surface) -> dict[str, Float64Array]:
    """What guides are to be proportional to, of directions that the BSDF scatters to: float64 (rows, 2 * rows).

    'RADIANCE': incident radiance; 'PRODUCT': that times BSDF times |cos|. Means over channels.
    """
    product = (radiance * surface.f_cos).mean(axis=-1)
    is_seen = surface.f_cos.max(axis=-1) > 0.0
    return {"RADIANCE": np.where(is_seen, radiance.mean(axis=-1), 0.0), "PRODUCT": product}


def normalized(values: Float64Array) -> Float64Array:
    """Density [sr^-1] proportional to a map of values that are not negative.

    Raises
    ------
    ValueError
        If all are zero.
    """
    total = float((values * cell_angles(values.shape[0])).sum())
    if not total > 0.0:
        raise ValueError("no light arrives at the point: choose another, or more samples")
    return values / total


def divergence(truth: Float64Array, density: Float64Array) -> float:
    """Kullback-Leibler divergence of a density from the truth [nat], both mixed with FLOOR of the uniform density.

    Parameters
    ----------
    truth, density : float64 (rows, 2 * rows) [sr^-1]
    """
    even = FLOOR / (4.0 * np.pi)
    p, q = (1.0 - FLOOR) * truth + even, (1.0 - FLOOR) * density + even
    return float((p * np.log(p / q) * cell_angles(truth.shape[0])).sum())


def own_target(settings: RenderSettings, surface: Surface) -> str:
    """Which of `targets` a method aims at, or comes closest to."""
    return implementation(settings.source).target(settings, is_diffuse=surface.is_diffuse)


@dataclass(frozen=True)
class LobeMap:
    """What a method has learned.

    density : float64 (rows, 2 * rows) [sr^-1]
    target : of `targets`, which the method aims at
    integral : float, of the density over the map; not 1 where lobes are narrower than the map can show
    divergence : dict by target [nat], nan where paths are not guided at the point
    status : str, of the training where there is any
    """

    method: str
    density: Float64Array
    target: str
    integral: float
    divergence: dict[str, float]
    status: str


@dataclass(frozen=True)
class Comparison:
    """Truths and methods at one surface.

    truths : dict by target of float64 (rows, 2 * rows) [sr^-1]
    noise : dict by target [nat], divergence between two halves of the truth's samples
    """

    surface: Surface
    truths: dict[str, Float64Array]
    noise: dict[str, float]
    methods: list[LobeMap]
    notices: list[str] = field(default_factory=list)


def compare(
    description: SceneDescription, settings: RenderSettings, pixel: tuple[int, int], methods: Sequence[str], *,
    rows: int, truth_samples: int,
) -> Comparison:
    """Let each method learn by rendering the scene, and compare it with the truth at a pixel.

    Parameters
    ----------
    settings : RenderSettings
        `samples` are those that the methods learn in.
    pixel : (int, int)
        Column and row, row 0 at the bottom.
    rows : int
        Rows of the maps, which have twice as many columns.
    truth_samples : int
        Samples of each direction of the truth.

    Raises
    ------
    ValueError
        If there is nothing to compare at the pixel.
    """
    settings = learning_settings(settings, settings.guiding_method)
    session = Session(settings)
    notices = [f"{notice.subject}: {notice.problem}" for notice in session.load(description)]
    assert session.scene is not None
    surface, _ = look(session.scene, replace(settings, guiding_method="VMM"), None, pixel, rows)
    halves = [targets(radiance, surface) for radiance in trace_truth(description, surface, settings, truth_samples)]
    truths = {name: normalized(halves[0][name] + halves[1][name]) for name in halves[0]}
    noise = {name: divergence(*(normalized(half[name]) for half in halves)) for name in truths}
    if not settings.use_nee:
        notices += [
            f"{light.name}: a light without size, which is not found without light sampling"
            for light in description.lights if not has_size(light)
        ]  # fmt: skip
    learned = []
    for method in methods:
        session.settings = learning_settings(settings, method)
        result = session.render()
        _, density = look(session.scene, session.settings, result.guidance, pixel, rows)
        about = [notice for notice in result.report.notices if method in notice.subject]
        notices += [f"{notice.subject}: {notice.problem}" for notice in about]
        differences = {
            name: divergence(truth, density) if density.any() else float("nan") for name, truth in truths.items()
        }
        integral = float((density * cell_angles(rows)).sum())
        aim = own_target(session.settings, surface)
        learned.append(LobeMap(method, density, aim, integral, differences, result.report.guiding.source))
    session.close()
    return Comparison(surface, truths, noise, learned, notices)
