# SPDX-License-Identifier: GPL-3.0-or-later
"""Build closures by node name and inputs, and integrate, sample and evaluate them: shared by the tests of lobes."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cache
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.stats import qmc

from engine.kernels.bsdf import (
    BsdfTables,
    PrincipledInputs,
    add_diffuse,
    add_glass,
    add_glossy,
    add_principled,
    add_refraction,
    add_translucent,
    add_transparent,
    eval_bsdf,
    load_tables,
    reset_closures,
    sample_bsdf,
    summarize,
    valid_specular_normal,
)
from engine.kernels.bsdf.glossy import film_of
from engine.kernels.bsdf.linked import LEAST_THICKNESS, change_lobe, model_of
from engine.kernels.bsdf.linked_lobes import ADDED, add_linked, link_lobes
from engine.kernels.bsdf.subsurface import RANDOM_WALK, SubsurfaceInputs
from engine.runtime.jit import kernel
from engine.state.lanes import Closures, allocate_closures

FloatArray = npt.NDArray[np.floating]

DIFFUSE, GLOSSY, REFRACTION, GLASS, PRINCIPLED, TRANSLUCENT, TRANSPARENT, MIXTURE, LINKED = range(9)
GGX, MULTI_GGX, BECKMANN, ASHIKHMIN_SHIRLEY = range(4)

#: Principled inputs in the order of `_VALUES`, with the node's defaults (white, so that energy is easy to check).
_SCALARS = {
    "roughness": 0.5,
    "ior": 1.5,
    "anisotropic": 0.0,
    "rotation": 0.0,
    "metallic": 0.0,
    "diffuse_roughness": 0.0,
    "specular_level": 0.5,
    "transmission": 0.0,
    "coat_weight": 0.0,
    "coat_roughness": 0.03,
    "coat_ior": 1.5,
    "sheen_weight": 0.0,
    "sheen_roughness": 0.5,
    "emission_strength": 0.0,
    "alpha": 1.0,
    "subsurface": 0.0,
    "anisotropy": 0.0,
    "thin_wall": 0.0,
    "film_thickness": 0.0,
    "film_ior": 1.33,
    # Of linked lobes: which it is, and its two numbers.
    "which": 0.0,
    "first": 0.5,
    "second": 0.0,
    # Whether facets of rough diffuse surfaces tint as in Blender 5.3.
    "tints_by_bounce": 0.0,
    # Whether glass of the Principled BSDF is as anisotropic as there.
    "stretches_glass": 0.0,
}
_COLORS = {
    "color": (1.0, 1.0, 1.0),
    "specular_tint": (1.0, 1.0, 1.0),
    "coat_tint": (1.0, 1.0, 1.0),
    "sheen_tint": (1.0, 1.0, 1.0),
    "emission_color": (1.0, 1.0, 1.0),
}


@dataclass(frozen=True)
class Case:
    """A closure to test: `node` is one of the constants above, `inputs` by the names of `_SCALARS` and `_COLORS`."""

    node: int
    inputs: dict[str, Any] = field(default_factory=dict)
    distribution: int = MULTI_GGX
    is_backfacing: bool = False
    is_bumped: bool = False

    def __str__(self) -> str:
        names = (
            *("diffuse", "glossy", "refraction", "glass", "principled", "translucent", "transparent", "mixture"),
            "linked",
        )
        inputs = ",".join(f"{name}={value}" for name, value in self.inputs.items())
        distribution = ("-ggx", "", "-beckmann", "-ashikhmin")[self.distribution]
        kind = f"{names[self.node]}{distribution}{'-back' if self.is_backfacing else ''}"
        kind += "-bumped" if self.is_bumped else ""
        return f"{kind}({inputs})"


@kernel
def _color(colors, k):
    return colors[k, 0], colors[k, 1], colors[k, 2]


@kernel
def _append(closures, tables, node, distribution, is_backfacing, values, colors, wo, ng, n, coat_n, tangent):
    """Append the lobes of a node to lane 0, as the shader interpreter does."""
    specular_n = valid_specular_normal(closures, 0, ng, wo, n)
    white = (1.0, 1.0, 1.0)
    color = _color(colors, 0)
    if node == 0:
        add_diffuse(closures, 0, color, n, values[0], color, values[23] != 0.0)
    elif node == 1:
        add_glossy(
            closures, tables, 0, white, color, wo, specular_n, tangent, distribution, values[0], values[2], values[3]
        )
    elif node == 2:
        add_refraction(
            closures, tables, 0, white, color, wo, specular_n, distribution, values[0], values[1], is_backfacing
        )
    elif node == 3:
        i = add_glass(
            closures, tables, 0, white, color, wo, specular_n, distribution, values[0], values[1], is_backfacing
        )
        if distribution >= 2 or values[18] > LEAST_THICKNESS:
            film = film_of(values[18], values[19], values[1], is_backfacing)
            change_lobe(closures, tables, 0, i, wo, model_of(distribution), film)
    elif node == 4:
        inputs = PrincipledInputs(
            distribution=distribution,
            base_color=color,
            metallic=values[4],
            roughness=values[0],
            diffuse_roughness=values[5],
            ior=values[1],
            specular_level=values[6],
            specular_tint=_color(colors, 1),
            anisotropic=values[2],
            anisotropic_rotation=values[3],
            tangent=tangent,
            transmission=values[7],
            coat_weight=values[8],
            coat_roughness=values[9],
            coat_ior=values[10],
            coat_tint=_color(colors, 2),
            coat_normal=coat_n,
            sheen_weight=values[11],
            sheen_roughness=values[12],
            sheen_tint=_color(colors, 3),
            emission_color=_color(colors, 4),
            emission_strength=values[13],
            alpha=values[14],
            subsurface=SubsurfaceInputs(RANDOM_WALK, values[15], (1.0, 0.2, 0.1), 0.0, 1.4, values[16]),
            thin_wall=values[17],
            film_thickness=values[18],
            film_ior=values[19],
            tints_by_bounce=values[23] != 0.0,
            stretches_glass=values[24] != 0.0,
        )
        add_principled(closures, tables, 0, white, wo, ng, n, is_backfacing, inputs)
    elif node == 5:
        add_translucent(closures, 0, color, specular_n)
    elif node == 6:
        add_transparent(closures, 0, color)


@kernel
def _append_linked(closures, tables, wo, ng, ns, is_backfacing, memory, code):
    place = (np.int64(0), np.int64(is_backfacing))
    add_linked(closures, tables, 0, (wo, ng, ns), np.float32(1.0), memory, code, place)


def _linked_instruction(case: Case, n: tuple, tangent: tuple) -> tuple[FloatArray, npt.NDArray[np.int32]]:
    """Memory and code of an instruction LINKED."""
    values = {**_SCALARS, **_COLORS, **case.inputs}
    which = ADDED["GLASS"] if case.node == GLASS else int(values["which"])
    numbers = [values["first"], values["second"], 0.0, 0.0, 0.0]
    if case.node == GLASS:
        values["specular_tint"] = (values["ior"], 0.0, 0.0)
    if which >= ADDED["METAL"]:
        numbers = [values[name] for name in ("roughness", "anisotropic", "rotation", "film_thickness", "film_ior")]
    memory = np.array([*n, *values["color"], *values["specular_tint"], *tangent, *numbers], np.float32)
    return memory, np.array([0, 0, 0, 0, 3, 6, 9, *range(12, 17), which, case.distribution], np.int32)


@kernel
def _sample(closures, tables, wo, ng, u, pdfs, directions, labels, values):
    """Sample lane 0 for every row of `u` (N, 3)."""
    for k in range(u.shape[0]):
        pdf, wi, label, _roughness, _eta = sample_bsdf(
            closures, tables, 0, wo, ng, u[k, 0], u[k, 1], u[k, 2], values, k
        )
        pdfs[k] = pdf
        labels[k] = label
        for axis in range(3):
            directions[k, axis] = wi[axis]


@kernel
def _evaluate(closures, tables, wo, ng, directions, visibility, pdfs, values):
    """Evaluate lane 0 for every row of `directions` (N, 3)."""
    for k in range(directions.shape[0]):
        wi = (directions[k, 0], directions[k, 1], directions[k, 2])
        pdfs[k] = eval_bsdf(closures, tables, 0, wo, wi, ng, visibility, values, k)


@kernel
def _reset(closures, ns, flags):
    reset_closures(closures, 0, ns, flags)


@kernel
def _summarize(closures):
    return summarize(closures, 0)


def vector(*values: float) -> tuple[np.float32, ...]:
    """Unit float32 tuple along `values`."""
    array = np.asarray(values, np.float64)
    return tuple(np.float32(value) for value in array / np.linalg.norm(array))


def at_cosine(cosine: float, phi: float = 0.0) -> tuple[np.float32, ...]:
    """Direction at an angle to +z."""
    sine = np.sqrt(1.0 - cosine**2)
    return vector(sine * np.cos(phi), sine * np.sin(phi), cosine)


UP = vector(0.0, 0.0, 1.0)


@cache
def sobol(log2_count: int, seed: int = 1) -> npt.NDArray[np.float32]:
    """Owen-scrambled Sobol points, float32 (2**log2_count, 3), below 1."""
    points = qmc.Sobol(3, seed=seed).random_base2(log2_count)
    return np.minimum(points, 1.0 - 2.0**-24).astype(np.float32)


class Lobes:
    """Closures of one or more cases seen from `wo`, on a surface with normals `ng`, `ns` (the coat's too) and `n`."""

    def __init__(
        self,
        *cases: Case,
        wo: tuple[np.float32, ...],
        ng: tuple[np.float32, ...] = UP,
        ns: tuple[np.float32, ...] = UP,
        n: tuple[np.float32, ...] = UP,
        tangent: tuple[np.float32, ...] = vector(1.0, 0.0, 0.0),
        flags: int = 0,
    ) -> None:
        self.wo, self.ng = wo, ng
        self.tables: BsdfTables = load_tables()
        self.closures: Closures = allocate_closures(1)
        _reset(self.closures, ns, flags)
        for case in cases:
            unknown = set(case.inputs) - set(_SCALARS) - set(_COLORS)
            assert not unknown, unknown
            is_film = case.inputs.get("film_thickness", 0.0) != 0.0
            is_stretched = case.node == GLASS and case.inputs.get("anisotropic", 0.0) != 0.0
            if case.node == LINKED or case.distribution >= BECKMANN or is_film or is_stretched:
                link_lobes()
            if case.node == LINKED or is_stretched:
                instruction = _linked_instruction(case, n, tangent)
                _append_linked(self.closures, self.tables, wo, ng, ns, case.is_backfacing, *instruction)
                continue
            values = np.array([case.inputs.get(k, default) for k, default in _SCALARS.items()], np.float32)
            colors = np.array([case.inputs.get(k, default) for k, default in _COLORS.items()], np.float32)
            _append(
                self.closures,
                self.tables,
                case.node,
                case.distribution,
                case.is_backfacing,
                values,
                colors,
                wo,
                ng,
                n,
                ns,
                tangent,
            )

    def sample(self, u: npt.NDArray[np.float32]) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
        """pdf (N,), directions (N, 3), labels (N,), f cos (N, 3) for numbers (N, 3)."""
        count = len(u)
        pdfs, directions = np.zeros(count, np.float32), np.zeros((count, 3), np.float32)
        labels, values = np.zeros(count, np.int32), np.zeros((count, 3), np.float32)
        _sample(self.closures, self.tables, self.wo, self.ng, u, pdfs, directions, labels, values)
        return pdfs, directions, labels, values

    def evaluate(self, directions: FloatArray, visibility: int = 63) -> tuple[FloatArray, FloatArray]:
        """pdf (N,) and f cos (N, 3) for directions (N, 3)."""
        pdfs, values = np.zeros(len(directions), np.float32), np.zeros((len(directions), 3), np.float32)
        wi = np.ascontiguousarray(directions, np.float32)
        _evaluate(self.closures, self.tables, self.wo, self.ng, wi, visibility, pdfs, values)
        return pdfs, values

    def albedo(self, log2_count: int = 14) -> FloatArray:
        """Directional albedo, float64 (3,): what a white world lights the surface with."""
        pdfs, _directions, _labels, values = self.sample(sobol(log2_count))
        valid = pdfs > 0.0
        return (values[valid].astype(np.float64) / pdfs[valid, None]).sum(0) / len(pdfs)

    def summary(self) -> int:
        """What `summarize` returns."""
        return int(_summarize(self.closures))
