# SPDX-License-Identifier: GPL-3.0-or-later
"""Light taken apart: by hand where it can be worked out on paper, and that the parts are the picture."""

from dataclasses import replace

import numpy as np
import pytest

from engine.render.light_passes import LIGHT_PASSES, divide_by_color, group_pass, light_part_count
from engine.render.session import Session
from engine.scene.description import Light, World
from engine.scene.rounds import RIBBONS
from engine.settings import RenderSettings
from tests.helpers.fur_scenes import chiang, fur_scene, hair_fibre
from tests.helpers.light_sums import sum_of_passes
from tests.helpers.seeded_renders import Z_LIMIT, z_score
from tests.helpers.small_scenes import corner_scene, floor_scene, material, sun
from tests.helpers.subsurface_scenes import below, box_scene

pytestmark = pytest.mark.estimator

PASSES = ("Combined", "Emission", "Environment", *LIGHT_PASSES)


def render(description, passes=PASSES, **settings):
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, **settings}))
    session.load(description)
    result = session.render(passes=passes)
    session.close()
    return result


def two_materials(description, second):
    """The description with `second` on its last instance."""
    description.materials = [description.materials[0], second]
    count = len(description.instances.mesh)
    description.instances.material_offset = np.array([0] * (count - 1) + [1], np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    return description


def sheet_scene(color, kind="ShaderNodeBsdfTransparent"):
    """A floor under a sun, seen through a sheet that covers it; the sun shines from below the sheet."""
    sheet = np.eye(4, dtype=np.float32)
    sheet[2, 3] = 5.0
    lamp = Light("point", "Point", "POINT", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), 500.0)
    lamp.transform = np.eye(4, dtype=np.float32)
    lamp.transform[2, 3] = 3.0
    description = floor_scene(lights=[lamp], transforms=[np.eye(4), sheet])
    return two_materials(description, material("Sheet", color, kind))


def test_a_diffuse_floor_under_a_sun_has_direct_light_alone():
    images = render(floor_scene(lights=[sun(2.0)], materials=[material(color=(0.6, 0.3, 0.0))])).passes
    assert np.allclose(images["Ambient Occlusion"], 1.0)
    assert np.allclose(images["Diffuse Color"], (0.6, 0.3, 0.0), rtol=1e-5)
    # White light, in the channel without colour too.
    assert np.allclose(images["Diffuse Direct"], 2.0 / np.pi, rtol=1e-4)
    for name in set(LIGHT_PASSES) - {"Diffuse Color", "Diffuse Direct", "Ambient Occlusion"}:
        assert not images[name].any(), name


def test_what_a_mirror_shows_is_direct_where_it_glows_and_indirect_where_it_is_lit():
    """A mirror below a lit ceiling, and below one that glows."""
    ceiling = np.diag([1.0, 1.0, -1.0, 1.0]).astype(np.float32)
    ceiling[2, 3] = 30.0
    mirror = material("Mirror", (0.9, 0.8, 0.7), "ShaderNodeBsdfGlossy")
    glow = material("Glow", (1, 2, 3), "ShaderNodeEmission")
    description = two_materials(floor_scene(transforms=[np.eye(4), ceiling]), glow)
    description.materials[0] = mirror
    images = render(description).passes
    assert np.allclose(images["Glossy Direct"], (1, 2, 3), rtol=1e-3)
    assert not images["Glossy Indirect"].any() and not images["Diffuse Color"].any()
    lamp = Light("lamp", "Lamp", "POINT", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), 1000.0)
    lamp.transform[2, 3] = 20.0
    description = two_materials(floor_scene(lights=[lamp], transforms=[np.eye(4), ceiling]), material())
    description.materials[0] = mirror
    images = render(description).passes
    assert images["Glossy Indirect"].min() > 0.0
    assert not images["Glossy Direct"].any()


def test_colours_behind_a_transparent_sheet_are_tinted_by_it():
    images = render(sheet_scene((0.5, 0.25, 1.0))).passes
    assert np.allclose(images["Diffuse Color"], (0.25, 0.125, 0.5), rtol=1e-4)
    assert not images["Transmission Color"].any()
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-5)


def test_translucent_light_is_diffuse():
    images = render(sheet_scene((0.5, 0.25, 1.0), "ShaderNodeBsdfTranslucent")).passes
    assert np.allclose(images["Diffuse Color"], (0.5, 0.25, 1.0), rtol=1e-4)
    assert images["Diffuse Direct"].min() > 0.0 and images["Diffuse Indirect"].max() > 0.0
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("method", ["RANDOM_WALK", "RANDOM_WALK_SKIN", "BURLEY"])
def test_light_from_below_a_surface_is_diffuse(method):
    """Direct too: what enters and comes out is one scattering, as in Cycles."""
    images = render(box_scene(below(method, (0.8, 0.5, 0.2), scale=0.1, Roughness=1.0)), samples=16).passes
    assert np.allclose(images["Diffuse Color"].mean(axis=(0, 1)), (0.8, 0.5, 0.2), rtol=0.02)
    assert images["Diffuse Direct"].min() > 0.0
    for name in ("Glossy Direct", "Glossy Indirect", "Transmission Direct", "Transmission Indirect"):
        assert not images[name].any(), name
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize(
    "fibre, lobe", [(hair_fibre("Reflection"), "Glossy"), (hair_fibre("Transmission"), "Transmission"),
                    (chiang(), "Glossy")],
    ids=["reflection", "transmission", "Chiang"],
)  # fmt: skip
def test_light_from_hair_is_of_its_lobe(fibre, lobe):
    other = {"Glossy": "Transmission", "Transmission": "Glossy"}[lobe]
    images = render(fur_scene(RIBBONS, fibre=fibre), samples=16).passes
    assert images[f"{lobe} Direct"].mean() > 0.0 and images[f"{lobe} Color"].mean() > 0.0
    assert not images[f"{other} Direct"].any() and not images[f"{other} Color"].any()
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-5)


def test_a_lamp_that_the_camera_sees_is_emission():
    lamp = Light("lamp", "Lamp", "POINT", np.eye(4, dtype=np.float32), (1.0, 0.5, 0.25), 100.0, radius=2.0)
    lamp.transform[2, 3] = 4.0
    images = render(floor_scene(lights=[lamp])).passes
    middle = images["Emission"][16, 24]
    assert middle[0] > 0.0 and np.allclose(middle, middle[0] * np.array((1.0, 0.5, 0.25)), rtol=1e-5)
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-6)


SETTINGS = [
    {},
    {"use_nee": False},
    {"clamp_direct": 0.2, "clamp_indirect": 0.05},
    pytest.param({"spectral": "ON"}, marks=pytest.mark.slow),  # compiles stages for wavelengths
    {"guiding_method": "VMM", "samples": 24, "guiding_trial": False},
    {"guiding_method": "TABLE_RIS", "samples": 24, "guiding_trial": False, "candidate_allocation": "FIXED"},
]


@pytest.mark.parametrize("settings", SETTINGS, ids=lambda settings: "-".join(settings) or "plain")
def test_the_sum_of_passes_is_the_picture(settings):
    description = corner_scene(size=(24, 20))
    description.world = World("world", "World", None, (0.2, 0.3, 0.4))
    images = render(description, **settings).passes
    combined = images["Combined"][..., :3]
    assert images["Diffuse Indirect"].mean() > 0.0
    assert np.allclose(sum_of_passes(images), combined, rtol=1e-4, atol=1e-5 * combined.max())


@pytest.mark.parametrize("kind", ["FAST", "CONVERGING"])
def test_the_radiance_cache_gives_indirect_light(kind):
    description = corner_scene(size=(24, 20))
    description.world = World("world", "World", None, (0.2, 0.3, 0.4))
    result = render(description, samples=64, radiance_cache=kind)
    assert sum(result.report.cached_shares) > 0.0
    images = result.passes
    assert np.allclose(sum_of_passes(images), images["Combined"][..., :3], rtol=1e-4, atol=1e-5)


def grouped_scene():
    """A corner lit by two suns and the world, each of a group of its own; what glows is of none."""
    description = corner_scene(size=(24, 20))
    other = replace(sun(1.0), key="other", name="Other", color=(1.0, 0.2, 0.1), light_group=1)
    description.lights = [replace(description.lights[0], light_group=0), other]
    description.world = World("world", "World", None, (0.2, 0.3, 0.4), light_group=2)
    description.light_groups = ("Key", "Rim", "Sky")
    return description


def test_light_groups_are_their_lights_alone():
    """The pass of a group is the picture with the lights of the other groups off."""
    description = grouped_scene()
    names = [group_pass(group) for group in description.light_groups]
    settings = {"max_bounces": 0, "samples": 16, "light_sampling_threshold": 0.0}
    images = render(description, passes=["Combined", *names], **settings).passes
    assert np.allclose(sum(images[name] for name in names), images["Combined"][..., :3], rtol=1e-5)
    alone = grouped_scene()
    alone.lights, alone.world = alone.lights[1:], None
    only = render(alone, passes=["Combined"], **settings).passes["Combined"][..., :3]
    assert only.mean() > 0.0
    # The tree picks lights at random.
    assert images[names[1]].mean(axis=(0, 1)) == pytest.approx(only.mean(axis=(0, 1)), rel=0.05)


def test_guided_light_is_in_the_group_of_its_light():
    """Each group's mean is that of unguided paths, and their sum is the picture."""
    names = [group_pass(group) for group in grouped_scene().light_groups]
    means = {}
    for method in ("OFF", "VMM"):
        found = []
        for seed in range(6):
            settings = {"guiding_method": method, "guiding_trial": False, "learn_guiding_probability": False}
            images = render(grouped_scene(), ["Combined", *names], samples=31, seed=seed, **settings).passes
            combined = images["Combined"][..., :3]
            assert np.allclose(sum(images[name] for name in names), combined, rtol=1e-4, atol=1e-5 * combined.max())
            found.append([images[name].mean() for name in names])
        means[method] = np.array(found)
    for plain, guided in zip(means["OFF"].T, means["VMM"].T, strict=True):
        assert z_score(guided, plain) < Z_LIMIT and guided.mean() == pytest.approx(plain.mean(), rel=0.02)


def test_light_of_no_group_is_in_no_pass():
    description = grouped_scene()
    description.lights[0] = replace(description.lights[0], light_group=-1)
    description.world = None
    names = [group_pass(group) for group in description.light_groups]
    images = render(description, passes=["Combined", *names]).passes
    assert not images[names[0]].any() and not images[names[2]].any()
    assert 0.0 < images[names[1]].mean() < 0.7 * images["Combined"][..., :3].mean()


def test_meshes_that_glow_have_groups():
    square = np.diag([0.05, 0.05, 1.0, 1.0]).astype(np.float32)
    square[2, 3] = 4.0
    glow = material("Glow", (4.0, 3.0, 2.0), "ShaderNodeEmission")
    description = two_materials(floor_scene(transforms=[np.eye(4), square]), glow)
    description.light_groups = ("None", "Glow")
    description.instances.light_group = np.array([-1, 1], np.int32)
    images = render(description, passes=["Combined", "Combined_None", "Combined_Glow"], samples=8).passes
    assert images["Combined_Glow"].mean() > 0.0 and not images["Combined_None"].any()
    # What the camera sees of it too.
    assert np.allclose(images["Combined_Glow"], images["Combined"][..., :3], rtol=1e-5)


def test_cells_of_the_cache_know_no_groups_and_the_report_says_so():
    description = grouped_scene()
    result = render(description, passes=["Combined", "Combined_Key"], radiance_cache="FAST", samples=8)
    assert any(notice.problem == "knows no light groups" for notice in result.report.notices)
    assert sum(result.report.cached_shares) == 0.0


@pytest.mark.parametrize("group", [-2, 3])
def test_a_group_that_does_not_exist_is_refused(group):
    description = grouped_scene()
    description.lights[1] = replace(description.lights[1], light_group=group)
    with pytest.raises(ValueError, match=f"light Other is of light group {group}"):
        render(description)
    description = grouped_scene()
    description.instances.light_group = np.array([0, group], np.int32)
    with pytest.raises(ValueError, match="object Floor is of light group"):
        render(description)


def test_the_picture_is_the_same_with_and_without_passes():
    description = grouped_scene()
    plain = render(description, passes=["Combined"]).passes["Combined"]
    split = render(description, passes=[*PASSES, "Combined_Key"]).passes["Combined"]
    assert np.array_equal(plain, split)


@pytest.mark.parametrize("distance", [10.0, 100.0])
def test_occlusion_is_what_hides_the_sky_within_a_distance(distance):
    """A floor and a wall of 50 m, at y = 3: the wall hides (1 - the cosine of its elevation) / 2 of the hemisphere."""
    wall = np.array([[1, 0, 0, 0], [0, 0, -1, 3], [0, 1, 0, 0], [0, 0, 0, 1]], np.float32)
    description = floor_scene(transforms=[np.eye(4), wall], size=(16, 16))
    description.world = World("world", "World", None)
    description.passes.occlusion_distance = distance
    images = render(description, passes=["Combined", "Ambient Occlusion", "Position"], samples=64).passes
    share, y = images["Ambient Occlusion"][..., 0], images["Position"][..., 1]
    z = images["Position"][..., 2]
    on_floor = (np.abs(z) < 1e-3) & (y < 2.5)
    assert on_floor.sum() > 50
    hidden = 1.0 - share[on_floor]
    whole = 0.5 * (1.0 - (3.0 - y[on_floor]) / np.hypot(3.0 - y[on_floor], 50.0))
    if distance > 90.0:
        assert hidden == pytest.approx(whole, abs=0.08) and hidden.mean() == pytest.approx(whole.mean(), abs=0.01)
    else:
        assert hidden.mean() < whole.mean() - 0.02


def test_light_samples_have_no_say_in_how_occlusion_is_clamped():
    """It is clamped as direct light; samples of the lamp are weighed against scattering, by which clamps see them."""
    above = np.eye(4, dtype=np.float32)
    above[2, 3] = 5.0
    lamp = Light("area", "Area", "AREA", above, (1.0, 1.0, 1.0), 30.0, size_x=10.0, size_y=10.0)
    description = floor_scene(lights=[lamp], size=(16, 16))
    images = render(description, passes=["Combined", "Ambient Occlusion"], clamp_direct=0.5).passes
    assert np.allclose(images["Ambient Occlusion"], 0.5)


def test_occlusion_alone_leaves_the_picture_as_it_is():
    description = grouped_scene()
    plain = render(description, passes=["Combined"]).passes["Combined"]
    assert np.array_equal(plain, render(description, passes=["Combined", "Ambient Occlusion"]).passes["Combined"])
    description.lights, description.world = [], None
    dark = render(description, passes=["Combined", "Ambient Occlusion"]).passes
    assert dark["Ambient Occlusion"].min() >= 0.0 and dark["Ambient Occlusion"].mean() > 0.3
    assert not dark["Combined"][..., :3].any()


def test_the_environment_pass_has_what_a_transparent_film_leaves_out():
    """A floor that ends in sight: the world is in the pass and in its group, in the picture it is not."""
    description = floor_scene(size=(16, 16), transforms=[np.diag([0.02, 0.02, 1.0, 1.0])])
    description.world = World("world", "World", None, (0.2, 0.4, 0.8), light_group=0)
    description.light_groups = ("Sky",)
    description.lights = []
    names = ["Combined", "Environment", "Combined_Sky", "Depth"]
    images = render(description, passes=names, samples=16, film_transparent=True).passes
    opaque = render(description, passes=names, samples=16).passes
    assert np.array_equal(images["Environment"], opaque["Environment"]) and images["Environment"].max() > 0.5
    assert np.allclose(images["Combined_Sky"], opaque["Combined"][..., :3], rtol=1e-5)
    assert np.allclose(images["Combined"][..., :3] + images["Environment"], opaque["Combined"][..., :3], rtol=1e-5)
    alone = render(description, passes=["Combined"], samples=16, film_transparent=True).passes["Combined"]
    assert np.array_equal(images["Combined"], alone) and alone[..., 3].min() < 0.1


def test_only_light_passes_need_parts():
    assert light_part_count(("Combined", "Depth", "Emission"), ("Key",)) == 0
    assert light_part_count(("Combined", "Glossy Color"), ()) == 6
    assert light_part_count(("Combined", "Combined_Key"), ("Key", "Rim")) == 8
    # What cells said, what was found of each group and of none, and two of media.
    assert light_part_count(("Combined", "Combined_Key"), ("Key", "Rim"), measures_groups=True) == 14


def test_dividing_keeps_white_light_white():
    light = np.array([(0.6, 0.3, 0.0), (0.0, 0.2, 0.0), (0.0, 0.0, 0.0), (2.0, 4.0, 6.0)], np.float32)
    color = np.array([(0.6, 0.3, 0.0), (0.0, 0.1, 0.0), (0.0, 0.0, 0.0), (1.0, 2.0, 4.0)], np.float32)
    expected = [(1.0, 1.0, 1.0), (2.0, 2.0, 2.0), (0.0, 0.0, 0.0), (2.0, 2.0, 1.5)]
    assert np.allclose(divide_by_color(light, color), expected, rtol=1e-6)
