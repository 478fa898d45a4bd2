# SPDX-License-Identifier: GPL-3.0-or-later
"""What each of Cycles' settings means here, by the panel in which Blender shows it."""

from __future__ import annotations

from collections.abc import Iterable
from typing import NamedTuple


class Row(NamedTuple):
    """A setting of Cycles: 'works', 'said' (a message says that it does not), 'no need' or 'no', and why.

    `is_newer`: Blender 5.0 does not have it yet.
    """

    name: str
    verdict: str
    note: str = ""
    is_newer: bool = False


def _rows(verdict: str, names: str, note: str = "", is_newer: bool = False) -> Iterable[Row]:
    return (Row(name, verdict, note, is_newer) for name in names.split())


_GUIDING = "see the panel Guiding"
#: Of volumes that are the same everywhere, which are rendered without steps.
_VOLUMES = "rays are followed without bias, and need no steps"
_SAMPLING = "noise alone: distances are picked among those of both kinds"
_GPU = "only the CPU renders"

#: (title of the panel, what has the settings, rows)
PANELS: tuple[tuple[str, str, tuple[Row, ...]], ...] = (
    (
        "Sampling", "scene.cycles",
        (
            *_rows("works", "samples time_limit"),
            *_rows("works", "use_adaptive_sampling adaptive_threshold adaptive_min_samples"),
            *_rows("works", "preview_samples use_preview_adaptive_sampling preview_adaptive_threshold"),
            *_rows("works", "preview_adaptive_min_samples"),
            *_rows("works", "preview_pause", "from Blender 5.3 on each viewport has a button of its own"),
            *_rows("said", "use_sample_subset"),
            *_rows("no", "sample_offset sample_subset_length", "belong to the subset of samples"),
            *_rows("works", "use_layer_samples light_sampling_threshold seed use_animated_seed"),
            *_rows("no need", "sampling_pattern", "always Owen-scrambled Sobol numbers in blue-noise order"),
            *_rows("no", "scrambling_distance preview_scrambling_distance auto_scrambling_distance"),
            *_rows("no need", "use_light_tree", "lights are always in a tree"),
            *_rows("said", "direct_light_sampling_type"),
            *_rows("works", "min_light_bounces min_transparent_bounces"),
            *_rows("said", "use_pixel_jitter", is_newer=True),
        ),
    ),
    (
        "Denoise", "scene.cycles",
        (
            *_rows("works", "use_denoising denoising_input_passes denoising_prefilter denoising_quality"),
            *_rows("said", "denoiser", "Open Image Denoise always"),
            *_rows("said", "denoising_use_gpu", _GPU),
            *_rows("works", "use_preview_denoising preview_denoising_prefilter preview_denoising_quality"),
            *_rows("works", "preview_denoising_input_passes preview_denoising_start_sample"),
            *_rows("no", "preview_denoiser", "Open Image Denoise always"),
            *_rows("no", "preview_denoising_use_gpu", _GPU),
            *_rows("no", "preview_denoising_upscale_quality", "belongs to DLSS", True),
        ),
    ),
    (
        "Path Guiding", "scene.cycles",
        (
            *_rows("no need", "use_guiding use_deterministic_guiding guiding_distribution_type", _GUIDING),
            *_rows("no need", "guiding_directional_sampling_type use_surface_guiding", _GUIDING),
            *_rows("no need", "surface_guiding_probability guiding_training_samples", _GUIDING),
            *_rows("no need", "use_guiding_direct_light use_guiding_mis_weights guiding_roughness_threshold", _GUIDING),
            *_rows("no need", "use_volume_guiding volume_guiding_probability", _GUIDING),
        ),
    ),
    (
        "Light Paths", "scene.cycles",
        (
            *_rows("works", "max_bounces diffuse_bounces glossy_bounces transmission_bounces volume_bounces"),
            *_rows("works", "transparent_max_bounces"),
            *_rows("works", "sample_clamp_direct sample_clamp_indirect blur_glossy"),
            *_rows("works", "caustics_reflective caustics_refractive"),
            *_rows("works", "use_fast_gi fast_gi_method ao_bounces ao_bounces_render"),
        ),
    ),
    (
        "Volumes", "scene.cycles",
        (*_rows("no need", "volume_biased volume_step_rate volume_preview_step_rate volume_max_steps", _VOLUMES),),
    ),
    (
        "Subdivision", "scene.cycles",
        (
            *_rows("said", "dicing_rate max_subdivisions dicing_camera offscreen_dicing_scale preview_dicing_rate",
                   "meshes that materials displace are diced; others are divided evenly, as often as this asks for"),
        ),
    ),
    (
        "Film", "scene.cycles",
        (
            *_rows("works", "film_exposure pixel_filter_type filter_width"),
            *_rows("said", "film_transparent_glass"),
            *_rows("no", "film_transparent_roughness", "belongs to Transparent Glass"),
        ),
    ),
    ("Motion Blur", "scene.cycles", (*_rows("works", "rolling_shutter_type rolling_shutter_duration"),)),
    (
        "Simplify", "scene.cycles",
        (
            *_rows("works", "use_camera_cull use_distance_cull camera_cull_margin distance_cull_margin",
                   "in viewports by the view at the last change of the scene"),
            *_rows("works", "texture_limit texture_limit_render"),
            *_rows("works", "texture_resolution texture_resolution_render", is_newer=True),
        ),
    ),
    (
        "Performance", "scene.cycles",
        (
            *_rows("said", "device", _GPU),
            *_rows("said", "shading_system"),
            *_rows("no need", "use_auto_tile tile_size", "pictures are in memory as a whole"),
            *_rows("no need", "debug_use_spatial_splits debug_use_hair_bvh debug_use_compact_bvh debug_bvh_time_steps",
                   "Embree is set up by NeuralGuide"),
            *_rows("no need", "debug_bvh_type debug_bvh_layout", "Embree is set up by NeuralGuide"),
            *_rows("no need", "debug_use_cpu_avx2 debug_use_cpu_sse42 debug_use_cuda_adaptive_compile",
                   "for developers of Cycles"),
            *_rows("no need", "debug_use_optix_debug debug_use_hip_adaptive_compile debug_use_metal_adaptive_compile",
                   "for developers of Cycles"),
            *_rows("no need", "debug_use_texture_cache_eviction debug_texture_cache_preserve_unused",
                   "for developers of Cycles", True),
        ),
    ),
    ("Baking", "scene.cycles", (*_rows("works", "bake_type"),)),
    (
        "Curves", "scene.cycles_curves",
        (*_rows("works", "shape subdivisions"),),
    ),
    (
        "View Layer", "view_layer.cycles",
        (
            *_rows("works", "use_denoising denoising_store_passes use_pass_shadow_catcher"),
            *_rows("no", "pass_debug_sample_count", "the pass Sample Count of NeuralGuide has counts, not shares"),
            *_rows("said", "pass_render_time"),
            *_rows("works", "use_pass_volume_direct use_pass_volume_indirect"),
            *_rows("said", "use_pass_volume_scatter use_pass_volume_transmit use_pass_volume_majorant"),
            *_rows("works", "denoising_store_motion_passes", is_newer=True),
            *_rows("works", "denoising_pass_follow_reflections denoising_pass_use_albedo_roughness_weighting",
                   "of Denoising Specular Albedo and Denoising Roughness alone", True),
        ),
    ),
    (
        "Object", "object.cycles",
        (
            *_rows("works", "use_motion_blur use_deform_motion motion_steps"),
            *_rows("works", "shadow_terminator_geometry_offset shadow_terminator_offset"),
            *_rows("works", "use_camera_cull use_distance_cull"),
            *_rows("works", "ao_distance"),
            *_rows("works", "is_caustics_caster is_caustics_receiver"),
        ),
    ),
    (
        "Light", "light.cycles",
        (
            *_rows("works", "max_bounces use_multiple_importance_sampling"),
            *_rows("works", "is_portal"),
            *_rows("works", "is_caustics_light"),
        ),
    ),
    (
        "Material", "material.cycles",
        (
            *_rows("works", "emission_sampling use_bump_map_correction"),
            *_rows("no need", "volume_sampling", _SAMPLING),
            *_rows("works", "volume_interpolation"),
            *_rows("no need", "volume_step_rate", _VOLUMES),
        ),
    ),
    (
        "World", "world.cycles",
        (
            *_rows("works", "sampling_method sample_map_resolution max_bounces"),
            *_rows("works", "is_caustics_light"),
            *_rows("works", "use_shadows", is_newer=True),
            *_rows("no need", "volume_sampling", _SAMPLING),
            *_rows("no need", "volume_interpolation", "a world has no voxels"),
            *_rows("no need", "volume_step_size", _VOLUMES),
        ),
    ),
)  # fmt: skip

#: What else is said of a panel, by its title.
TEXTS: dict[str, str] = {
    "Baking": """\
All of Cycles' types are baked: Combined, Ambient Occlusion, Shadow, Position, Normal, UV, Roughness, Emit, Environment,
and Diffuse, Glossy and Transmission by direct light, indirect light and colour. The panels are Cycles' own. Margin,
Selected to Active, cages, images, their tiles and colour attributes are Blender's work: it says which place of which
object each texel shows, and NeuralGuide what is seen there.

A bake is a render whose paths begin at these places instead of at the camera. So the scene's samples, noise threshold,
time limit, guiding, Accuracy, bounces and clamps count. A path starts a few rounding errors above its place, looks at
it along the shading normal (or from the camera, where View From says so), and meets it whatever else lies there: faces
in the same place do not come before it. Within a texel places are drawn evenly, never beside the texel's face; the
first sample looks at its centre. What lets light through shows nothing behind it, and alpha says how much. Nothing is
blurred by motion, and no camera is needed but for View From.

Faces whose UVs lie over each other are baked as Blender gives the texels, to the last of them, as by Cycles, and the
object is named. A bake that is cancelled leaves the samples that there are.

Only Combined is denoised, where the scene is. Refused with a message are View From without a camera, an object that no
ray meets, faces with vertices that are NaN or infinite, and images that the memory does not hold. Blender itself
refuses objects without UVs or faces.""",
}
