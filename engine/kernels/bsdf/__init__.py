# SPDX-License-Identifier: GPL-3.0-or-later
"""Closures: append them (`add_*`), evaluate and sample their sum (`eval_bsdf`, `sample_bsdf`).

A lane's list starts with `reset_closures`. `add_glossy`, `add_refraction`, `add_glass` and `add_translucent` expect the
normal that `valid_specular_normal` returns, `add_diffuse` and `add_principled` the plain one. Whether caustics are
switched off is the caller's business for the first two; glass and Principled look at `Closures.flags`.
"""

from engine.kernels.bsdf.closures import blur_glossy as blur_glossy
from engine.kernels.bsdf.closures import keeps_to_geometry as keeps_to_geometry
from engine.kernels.bsdf.closures import reset_closures as reset_closures
from engine.kernels.bsdf.closures import summarize as summarize
from engine.kernels.bsdf.diffuse import add_diffuse as add_diffuse
from engine.kernels.bsdf.evaluate import DELTA_LOBES as DELTA_LOBES
from engine.kernels.bsdf.evaluate import EVERY_LOBE as EVERY_LOBE
from engine.kernels.bsdf.evaluate import ROUGH_LOBES as ROUGH_LOBES
from engine.kernels.bsdf.evaluate import add_albedo as add_albedo
from engine.kernels.bsdf.evaluate import albedo as albedo
from engine.kernels.bsdf.evaluate import eval_bsdf as eval_bsdf
from engine.kernels.bsdf.evaluate import sample_among as sample_among
from engine.kernels.bsdf.evaluate import sample_bsdf as sample_bsdf
from engine.kernels.bsdf.glossy import add_glass as add_glass
from engine.kernels.bsdf.glossy import add_glossy as add_glossy
from engine.kernels.bsdf.glossy import add_refraction as add_refraction
from engine.kernels.bsdf.guided import eval_guided as eval_guided
from engine.kernels.bsdf.guided import mean_roughness as mean_roughness
from engine.kernels.bsdf.guided import rough_share as rough_share
from engine.kernels.bsdf.hair import feature_normal as feature_normal
from engine.kernels.bsdf.kinds import HAS_DELTA as HAS_DELTA
from engine.kernels.bsdf.kinds import HAS_EVAL as HAS_EVAL
from engine.kernels.bsdf.kinds import HAS_TRANSMISSION as HAS_TRANSMISSION
from engine.kernels.bsdf.kinds import HAS_TRANSPARENT as HAS_TRANSPARENT
from engine.kernels.bsdf.no_lobes import add_emission as add_emission
from engine.kernels.bsdf.no_lobes import add_holdout as add_holdout
from engine.kernels.bsdf.no_lobes import add_transparent as add_transparent
from engine.kernels.bsdf.normals import ensure_valid_specular_reflection as ensure_valid_specular_reflection
from engine.kernels.bsdf.normals import valid_specular_normal as valid_specular_normal
from engine.kernels.bsdf.oren_nayar import add_oren_nayar as add_oren_nayar
from engine.kernels.bsdf.parts import DIFFUSE_LOBES as DIFFUSE_LOBES
from engine.kernels.bsdf.parts import GLOSSY_LOBES as GLOSSY_LOBES
from engine.kernels.bsdf.parts import TRANSMISSIVE_LOBES as TRANSMISSIVE_LOBES
from engine.kernels.bsdf.parts import albedo_parts as albedo_parts
from engine.kernels.bsdf.parts import share_lobes as share_lobes
from engine.kernels.bsdf.principled import PrincipledInputs as PrincipledInputs
from engine.kernels.bsdf.principled import add_principled as add_principled
from engine.kernels.bsdf.tables import BsdfTables as BsdfTables
from engine.kernels.bsdf.tables import load_tables as load_tables
from engine.kernels.bsdf.translucent import add_translucent as add_translucent
