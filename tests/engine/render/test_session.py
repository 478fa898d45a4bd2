# SPDX-License-Identifier: GPL-3.0-or-later
"""The engine without Blender: known pixels, the same image for any thread count, cancel, bounds, bad samples."""

import threading
import time

import numpy as np
import pytest

from engine.render.film import Film
from engine.render.schedule import sample_ranges
from engine.render.session import Session
from engine.render.tiles import FrameTiles
from engine.scene.description import (
    Frame,
    Light,
    Link,
    Material,
    Node,
    NodeGraph,
    World,
)
from engine.scene.instances import empty_instances, plain_instances
from engine.settings import RenderSettings
from engine.state.film import allocate_tile
from engine.state.lights import HEADER_SOURCES
from tests.helpers.placed_quads import at
from tests.helpers.small_scenes import floor_scene, material, pit_scene, sun


def render(description, passes=("Combined",), **settings):
    session = Session(RenderSettings(**{"samples": 4, "threads": 1, **settings}))
    session.load(description)
    result = session.render(passes=passes)
    session.close()
    return result


def test_a_floor_under_a_sun_reflects_albedo_over_pi():
    image = render(floor_scene(lights=[sun(2.0)])).passes["Combined"]
    assert np.allclose(image[..., :3], 0.5 / np.pi * 2.0, rtol=1e-4)
    assert (image[..., 3] == 1.0).all()


@pytest.mark.parametrize("strength", [2.0, 2e-9])
def test_shadows_of_transparent_surfaces_do_not_depend_on_the_unit_of_light(strength):
    """A sheet that lets a tenth through, high above the floor and behind the camera; the sun shines through it."""
    sheet = np.eye(4, dtype=np.float32)
    sheet[2, 3] = 20.0
    clear = material("Clear", (0.1, 0.1, 0.1), "ShaderNodeBsdfTransparent")
    description = floor_scene(lights=[sun(strength)], transforms=[np.eye(4), sheet], materials=[material(), clear])
    description.instances.material_offset = np.array([0, 1], np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    image = render(description, light_sampling_threshold=0.0).passes["Combined"]
    assert np.allclose(image[..., :3], 0.5 / np.pi * 0.1 * strength, rtol=1e-4, atol=0.0)


def panes_scene():
    """A pit under a sun, covered by sheets that let light through everywhere and some that do by a pattern."""
    tinted = material("Tinted", (0.97, 0.98, 0.99), "ShaderNodeBsdfTransparent")
    colors = {"Color1": (1.0, 1.0, 1.0, 1.0), "Color2": (0.0, 0.0, 0.0, 1.0)}
    checker = Node("ShaderNodeTexChecker", "Checker", {"Scale": 0.3, **colors})
    cut = Node("ShaderNodeBsdfTransparent", "Cut", {"Color": Link(0, "Color")})
    description = pit_scene()
    description.materials += [tinted, Material("Cut", "Cut", NodeGraph([checker, cut], Link(1, "BSDF")))]
    sheets = np.stack([at(0, 0, height) for height in np.linspace(20.0, 25.0, 40)]).astype(np.float32)
    walls = np.concatenate([description.instances.transform, [at(60.0 + i, 0, -60.0) for i in range(760)]])
    description.instances = plain_instances(np.concatenate([walls, sheets]), name="Part")
    description.instances.material_offset = np.array([0] * len(walls) + [1] * 39 + [2], np.int32)
    description.instances.materials = np.array([0, 1, 2], np.int32)
    return description


def test_transparent_casters_of_shadows_give_the_same_picture_in_a_hierarchy_of_their_own():
    session = Session(RenderSettings(samples=4, threads=1, max_bounces=4, transparent_max_bounces=64))
    session.load(panes_scene())
    accelerator = session.scene.accelerator
    assert accelerator.transparent is not accelerator.top
    apart = session.render()
    accelerator.transparent = accelerator.top
    together = session.render()
    session.close()
    assert apart.report.rays["transparent_shadow"] > 0
    assert apart.report.rays == together.report.rays
    picture = apart.passes["Combined"]
    assert np.unique(picture[..., 0].round(3)).size > 2
    assert np.array_equal(picture, together.passes["Combined"])


def lit_room():
    """Two facing floors, the upper one small and glowing: paths end in the dark more often than not."""
    upper = np.diag([0.02, 0.02, 1.0, 1.0])
    upper[:3, 3] = 0.0, 0.0, 4.0
    wall = np.array([[1.0, 0.0, 0.0, 30.0], [0.0, 0.0, -1.0, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
    glow = material("Glow", (3.0, 2.0, 1.0), "ShaderNodeEmission")
    description = floor_scene(transforms=[np.eye(4), upper, wall], materials=[material(color=(0.9, 0.8, 0.7)), glow])
    description.instances.material_offset = np.array([0, 1, 0], np.int32)
    description.instances.materials = np.array([0, 1], np.int32)
    return description


@pytest.mark.parametrize(("max_bounces", "share"), [(0, 0.7), (3, 0.98)])
def test_rays_that_can_find_no_light_are_not_traced_and_the_image_stays_the_same(max_bounces, share):
    session = Session(RenderSettings(samples=16, threads=1, max_bounces=max_bounces))
    session.load(lit_room())
    assert session.scene.lights.header[HEADER_SOURCES] == 1
    quick = session.render()
    session.scene.lights.header[HEADER_SOURCES] = -1
    whole = session.render()
    session.close()
    assert whole.passes["Combined"][..., :3].max() > 0.0
    assert np.array_equal(quick.passes["Combined"], whole.passes["Combined"])
    assert quick.report.rays["closest"] < share * whole.report.rays["closest"]
    assert quick.report.rays["shadow"] == whole.report.rays["shadow"]


@pytest.mark.parametrize(
    "changes",
    [
        {"world": World("w", "World", None, (1.0, 1.0, 1.0))},
        {"lights": [Light("p", "Point", "POINT", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), 1.0, radius=0.1)]},
        {"lights": [Light("s", "Sun", "SUN", np.eye(4, dtype=np.float32), (1.0, 1.0, 1.0), 1.0, angle=0.1)]},
    ],
)
def test_every_ray_is_traced_where_light_may_come_from_anywhere(changes):
    session = Session(RenderSettings(samples=1, threads=1))
    session.load(floor_scene(**changes))
    assert session.scene.lights.header[HEADER_SOURCES] == -1
    session.close()


def test_exposure_is_a_factor():
    description = floor_scene(lights=[sun(2.0)])
    description.frame.exposure = 3.0
    assert np.allclose(render(description).passes["Combined"][..., :3], 3.0 / np.pi, rtol=1e-4)


def test_an_open_floor_under_a_white_world_is_its_albedo():
    """No noise: a constant world found by cosine sampling has zero variance."""
    image = render(floor_scene(world=World("w", "World", None, (1.0, 1.0, 1.0)))).passes["Combined"]
    assert np.allclose(image[..., :3], 0.5, atol=1e-5)


TILTED = np.eye(4)
TILTED[2, :2] = 0.1, 0.2


@pytest.mark.parametrize(("transform", "cycles"), [(np.eye(4), 0.0002), (TILTED, 0.3601)], ids=["level", "tilted"])
def test_unmoved_copies_shadow_each_other_as_in_cycles(transform, cycles):
    """A gray floor twice: black where it is level, elsewhere by the last bit of each ray."""
    description = floor_scene(world=World("w", "World", None, (1.0, 1.0, 1.0)), transforms=[transform] * 2)
    image = render(description, samples=64).passes["Combined"][..., :3]
    assert image.mean() == pytest.approx(cycles, abs=0.03)


@pytest.mark.parametrize(("transform", "cycles"), [(np.eye(4), 0.0002), (TILTED, 0.2801)], ids=["level", "tilted"])
def test_coincident_faces_shadow_each_other_as_in_cycles(transform, cycles):
    """A gray floor, and a larger one in the same plane."""
    transforms = [transform, transform @ np.diag([1.1, 1.1, 1.0, 1.0])]
    description = floor_scene(world=World("w", "World", None, (1.0, 1.0, 1.0)), transforms=transforms)
    image = render(description, samples=64).passes["Combined"][..., :3]
    assert image.mean() == pytest.approx(cycles, abs=0.03)


def test_faces_that_are_apart_do_not_shadow_each_other():
    below = np.eye(4)
    below[2, 3] = -1e-3
    description = floor_scene(world=World("w", "World", None, (1.0, 1.0, 1.0)), transforms=[np.eye(4), below])
    assert np.allclose(render(description).passes["Combined"][..., :3], 0.5, atol=1e-5)


def test_the_image_is_the_same_bit_for_bit_for_any_thread_count():
    transforms = [np.eye(4), np.eye(4)]
    transforms[1] = transforms[1].copy()
    transforms[1][2, 3], transforms[1][0, 0], transforms[1][1, 1] = 2.0, 0.02, 0.02
    lamp = Light("p", "Point", "POINT", np.eye(4, dtype=np.float32), (1, 1, 1), 500.0, radius=0.5)
    lamp.transform[2, 3] = 5.0
    description = floor_scene(
        lights=[lamp], world=World("w", "World", None, (0.2, 0.3, 0.4)), transforms=transforms, size=(70, 45)
    )
    passes = ("Combined", "Depth", "Normal", "Albedo", "Variance")
    one = render(description, passes, samples=9, threads=1).passes
    for threads in (2, 3):
        several = render(description, passes, samples=9, threads=threads).passes
        for name in passes:
            assert np.array_equal(one[name], several[name]), name
    assert one["Combined"][..., :3].std() > 0.0
    assert not np.array_equal(one["Combined"], render(description, samples=9, seed=1).passes["Combined"])


def test_passes_of_the_first_surface():
    passes = ("Combined", "Depth", "Normal", "Position", "Albedo", "IndexOB", "Sample Count", "Environment", "Emission")
    images = render(floor_scene(lights=[sun()]), passes, pixel_filter="BOX").passes
    assert np.allclose(images["Depth"], 10.0, atol=1e-4)
    assert np.allclose(images["Normal"], (0, 0, 1), atol=1e-6)
    assert np.allclose(images["Position"][..., 2], 0.0, atol=1e-4)
    assert np.allclose(images["Albedo"], 0.5, atol=1e-5)
    assert (images["IndexOB"] == 7.0).all()
    assert (images["Sample Count"] == 4.0).all()
    assert (images["Environment"] == 0.0).all()
    position = images["Position"]
    assert (np.diff(position[..., 0], axis=1) > 0.0).all()
    assert (np.diff(position[..., 1], axis=0) > 0.0).all()


def test_emission_is_seen_whole():
    glowing = material("Lamp", (3.0, 2.0, 1.0), "ShaderNodeEmission")
    glowing.graph.nodes[0].inputs["Strength"] = 2.0
    images = render(floor_scene(materials=[glowing]), ("Combined", "Emission")).passes
    assert np.allclose(images["Combined"][..., :3], (6.0, 4.0, 2.0), rtol=1e-5)
    assert np.allclose(images["Emission"], (6.0, 4.0, 2.0), rtol=1e-5)


def test_transparent_film_has_no_background_but_alpha():
    description = floor_scene(world=World("w", "World", None, (1, 1, 1)))
    description.instances.transform[0, 0, 0] = 0.02
    opaque = render(description).passes["Combined"]
    clear = render(description, film_transparent=True).passes["Combined"]
    outside = clear[..., 3] < 1e-6
    assert 0.2 < outside.mean() < 0.95
    assert np.allclose(opaque[outside][:, :3], 1.0)
    assert (clear[outside] == 0.0).all()
    inside = clear[..., 3] > 1.0 - 1e-6
    assert np.allclose(clear[inside][:, :3], opaque[inside][:, :3])


def test_a_border_shows_the_same_pixels():
    description = floor_scene(world=World("w", "World", None, (1, 1, 1)), lights=[sun()])
    whole = render(description).passes["Combined"]
    description.frame.region = (10, 5, 31, 29)
    part = render(description).passes["Combined"]
    assert part.shape == (24, 21, 4)
    assert np.array_equal(part, whole[5:29, 10:31])


def test_cancel_stops_within_0_3_seconds_and_keeps_what_there_is():
    description = floor_scene(world=World("w", "World", None, (1, 1, 1)), lights=[sun()], size=(320, 240))
    session = Session(RenderSettings(samples=100_000, threads=2))
    session.load(description)
    cancelled_at = []
    timer = threading.Event()

    def should_cancel():
        if timer.is_set() and not cancelled_at:
            cancelled_at.append(time.process_time())
        return timer.is_set()

    def on_progress(progress):
        if progress.sample >= 2:
            timer.set()

    result = session.render(should_cancel=should_cancel, on_progress=on_progress)
    # Time of two threads, and not of the clock: others may have the processors.
    assert time.process_time() - cancelled_at[0] < 2.0 * 0.3
    assert result.report.cancelled
    assert result.report.sample_count > 0.0
    image = result.passes["Combined"]
    assert np.isfinite(image).all()
    assert (image[..., 0] > 0.0).any()


def test_a_time_limit_ends_the_render():
    session = Session(RenderSettings(samples=1_000_000, time_limit=0.5, threads=2))
    session.load(floor_scene(lights=[sun()], size=(64, 64)))
    started = time.process_time()
    result = session.render()
    # By the clock others may have the processors meanwhile.
    assert result.report.render_seconds > 0.4 and time.process_time() - started < 2.0 * 2.0
    assert result.report.ended_by == "TIME_LIMIT"
    assert not result.report.cancelled
    assert result.report.sample_count >= 1.0


def test_images_come_while_it_renders():
    images = []
    session = Session(RenderSettings(samples=200_000, time_limit=1.5, threads=2))
    session.load(floor_scene(lights=[sun()], size=(64, 64)))
    session.render(on_image=images.append)
    assert images
    assert np.isfinite(images[0]["Combined"]).all()


def test_an_empty_scene_is_black_and_a_missing_one_is_refused():
    description = floor_scene()
    description.meshes, description.instances = [], empty_instances()
    assert (render(description).passes["Combined"][..., :3] == 0.0).all()
    with pytest.raises(RuntimeError, match="load"):
        Session(RenderSettings()).render()


def test_samples_that_are_not_numbers_are_counted_and_left_out():
    glowing = material("Lamp", (1.0, 1.0, 1.0), "ShaderNodeEmission")
    glowing.graph.nodes[0].inputs["Strength"] = float("inf")
    result = render(floor_scene(materials=[glowing]))
    assert result.report.reject_count == 4 * 48 * 32
    # As in Cycles they are black, and no less there.
    assert (result.passes["Combined"] == (0.0, 0.0, 0.0, 1.0)).all()


def test_geometry_is_kept_between_frames_while_nothing_changes():
    session = Session(RenderSettings(samples=1, threads=1))
    description = floor_scene(lights=[sun()])
    session.load(description)
    first = session.scene
    session.load(floor_scene(lights=[sun(5.0)]))
    assert session.scene.accelerator is first.accelerator
    moved = floor_scene(lights=[sun()])
    moved.instances.transform[0, 2, 3] = 1.0
    session.load(moved)
    assert session.scene.accelerator is not first.accelerator


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda d: setattr(d, "frame", Frame(0, 10, (0, 0, 0, 10))), "resolution"),
        (lambda d: setattr(d.frame, "region", (5, 5, 5, 9)), "border"),
        (lambda d: setattr(d.camera, "transform", np.full((4, 4), np.nan, np.float32)), "camera"),
    ],
)
def test_bad_input_is_named(change, word):
    description = floor_scene()
    change(description)
    with pytest.raises(ValueError, match=word):
        Session(RenderSettings()).load(description)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("samples", 0), ("time_limit", -1.0), ("time_limit", float("nan")), ("guiding_method", "X"), ("threads", -2),
        ("spectral", "X"), ("training_share", 0.0), ("guiding_probability", 1.0), ("training_steps", 0),
    ],
)
def test_bad_settings_are_named(setting, value):
    with pytest.raises(ValueError, match=setting):
        RenderSettings(**{setting: value})


def test_sample_ranges_cover_every_sample_once():
    for samples in (1, 2, 7, 64, 1000):
        ranges = sample_ranges(samples)
        assert [first for first, _ in ranges] == list(np.cumsum([0] + [count for _, count in ranges])[:-1])
        assert sum(count for _, count in ranges) == samples


def test_tiles_cover_every_pixel_once():
    tiles = FrameTiles(Frame(100, 80, (3, 7, 90, 71)))
    indices = np.concatenate([index for _, index in tiles])
    assert np.array_equal(np.sort(indices), np.arange(87 * 64))


def test_film_statistics():
    """Mean and variance of the mean from merged tiles of known samples."""
    film = Film(2, 1)
    values = np.array([1.0, 3.0, 5.0, 7.0], np.float32)
    for part in (values[:1], values[1:]):
        tile = allocate_tile(2, 3)
        tile.radiance[:] = part.sum()
        tile.square[:] = (part**2).sum()
        tile.count[:] = len(part)
        film.merge(np.array([0, 1]), tile)
    images = film.passes({"Combined", "Variance", "Sample Count"}, exposure=2.0)
    assert np.allclose(images["Combined"][..., :3], 8.0)
    assert np.allclose(images["Variance"], 4.0 * values.var(ddof=1) / 4, rtol=1e-5)
    assert (images["Sample Count"] == 4.0).all()


def test_a_holdout_leaves_a_hole_in_alpha():
    description = floor_scene(world=World("w", "World", None, (1, 1, 1)))
    description.instances.is_holdout[0] = True
    image = render(description, film_transparent=True).passes["Combined"]
    assert (image == 0.0).all()
