# SPDX-License-Identifier: GPL-3.0-or-later
"""What moves while the shutter is open: keys, rays, shading, emitters and the camera at a path's time."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bias import find_bias
from engine.accel.rays import trace_closest
from engine.accel.scratch import RayScratch
from engine.builder.camera import shutter_table
from engine.builder.geometry import build_geometry
from engine.builder.lights import build_lights
from engine.builder.motion import MOST_KEYS, corners_in_motion, interpolation_keys, is_in_motion
from engine.guiding.policy import sets
from engine.kernels.camera import sample_table
from engine.kernels.motion import (
    direction_to_object,
    direction_to_world,
    matrix_between,
    normal_to_object,
    normal_to_world,
    point_to_object,
    point_to_world,
)
from engine.kernels.surface import surface_point
from engine.render.session import Session
from engine.runtime.jit import kernel
from engine.scene.description import Camera, Light, World
from engine.settings import RenderSettings
from tests.helpers import light_probe
from tests.helpers.placed_quads import at, built, quad_scene, steps, turned
from tests.helpers.seeded_renders import render_seeds
from tests.helpers.small_scenes import emitter_scene, floor_scene, sun
from tests.helpers.untrained_networks import Untrained, guess


def key(keys, time):
    """Matrix (3, 4) between keys."""
    return np.array(matrix_between(keys, 0, len(keys), np.float32(time))).reshape(3, 4)


# ---------------------------------------------------------------------------------------------------------------------
# Keys


def test_what_does_not_turn_needs_no_more_keys_than_it_is_given():
    moves = steps(at(0, 0, 0), at(1, 2, 3, (2.0, 1.0, 0.5)), at(5, 0, 0, (-1.0, 1.0, 1.0)))
    keys = interpolation_keys(moves[:2])
    assert len(keys) == 2
    assert np.allclose(key(keys, 0.25), 0.75 * moves[0, :3] + 0.25 * moves[1, :3], atol=1e-6)


@pytest.mark.parametrize("mirror", [1.0, -1.0])
@pytest.mark.parametrize("angle", [0.3, 2.0, 3.1])
def test_turns_follow_the_arc_at_even_speed(angle, mirror):
    scale = (1.5, 0.5 * mirror, 2.0)
    keys = interpolation_keys(steps(turned(0.0, scale=scale), turned(angle, position=(4, 0, 0), scale=scale)))
    assert len(keys) <= MOST_KEYS
    for time in np.linspace(0.0, 1.0, 23):
        expected = turned(time * angle, position=(4.0 * time, 0, 0), scale=scale)[:3]
        assert np.allclose(key(keys, time), expected, atol=2.0 * 2e-4), time


def test_a_quarter_of_a_turn_and_back_takes_the_shorter_way_both_times():
    angles = (3.0, 3.5, 3.0)  # past half a turn, where quaternions change sides
    keys = interpolation_keys(steps(*(turned(angle, axis=0) for angle in angles)))
    assert np.allclose(key(keys, 0.25), turned(3.25, axis=0)[:3], atol=2e-4)
    assert np.allclose(key(keys, 0.75), turned(3.25, axis=0)[:3], atol=2e-4)


def test_hosts_own_matrices_are_met_whatever_they_are():
    random = np.random.default_rng(1)
    matrices = np.tile(np.eye(4), (5, 1, 1))
    matrices[:, :3] += random.normal(size=(5, 3, 4))  # sheared, mirrored
    keys = interpolation_keys(matrices.astype(np.float32))
    for index in range(5):
        assert np.allclose(key(keys, index / 4), matrices[index, :3], rtol=1e-5, atol=1e-5)
    assert (len(keys) - 1) % 4 == 0 and len(keys) <= MOST_KEYS and np.isfinite(keys).all()


def test_motions_that_embree_cannot_take_are_refused():
    for count in (1, MOST_KEYS + 1):
        with pytest.raises(ValueError, match="2 to 129"):
            interpolation_keys(steps(*[np.eye(4)] * count))


# ---------------------------------------------------------------------------------------------------------------------
# Rays and shading at a time


@kernel
def _hits(scene, ray, bits, address, geometry, origin, direction, times, found, position, ng, ns, error):
    for i in range(origin.shape[0]):
        o = (origin[i, 0], origin[i, 1], origin[i, 2])
        d = (direction[i, 0], direction[i, 1], direction[i, 2])
        found[i] = -1.0
        if trace_closest(scene, ray, bits, address, o, d, 0.0, 1e30, times[i], 1):
            found[i] = ray[8]
            instance = bits[19] if bits[19] != 0xFFFFFFFF else bits[18]
            p, a, b, e = surface_point(geometry, np.int64(instance), np.int64(bits[17]), ray[15], ray[16], times[i])
            error[i] = e
            for c in range(3):
                position[i, c] = p[c]
                ng[i, c] = a[c]
                ns[i, c] = b[c]


def hits(description, origin, times):
    """Rays straight down: distances, -1 = none, and what `surface_point` says of where they meet."""
    geometry, accelerator = built(description)
    count = len(times)
    scratch = RayScratch()
    origin = np.ascontiguousarray(origin, np.float32)
    direction = np.tile(np.array([(0.0, 0.0, -1.0)], np.float32), (count, 1))
    found, error = np.zeros(count, np.float32), np.zeros(count, np.float32)
    position, ng, ns = (np.zeros((count, 3), np.float32) for _ in range(3))
    _hits(
        accelerator.handle, scratch.ray, scratch.bits, scratch.address, geometry, origin, direction,
        np.asarray(times, np.float32), found, position, ng, ns, error,
    )  # fmt: skip
    return found, position, ng, ns, error


def deforming(description, heights):
    """The description's mesh, whose corner 2 is lifted to each of `heights` in turn."""
    mesh = description.meshes[0]
    shapes = np.tile(mesh.vertices, (len(heights), 1, 1))
    shapes[:, 2, 2] = heights
    mesh.motion_vertices = shapes
    mesh.vertices = shapes[len(heights) // 2]
    return description


def moving_scenes():
    spin = steps(*(turned(a, axis=0, position=(0.3 * a, 0, a)) for a in (-0.7, 0.0, 0.4)))
    alone = quad_scene([spin[1]])
    alone.instances.motion[0] = spin
    many = quad_scene([at(0, 0, -50), spin[1]])
    many.instances.motion[1] = spin
    both = deforming(quad_scene([spin[1]]), (0.0, 0.5, 0.2))
    both.instances.motion[0] = spin
    return {
        "alone": alone,
        "among others": many,
        "other shape": deforming(quad_scene([turned(0.2, position=(1000.0, 0, 3))]), (0.0, 0.5, 0.2)),
        "instances of another shape": deforming(quad_scene([at(0, 0, 2), at(0, 0, -20)]), (-0.5, 0.5)),
        "both": both,
    }


@pytest.mark.parametrize("name", list(moving_scenes()))
def test_shading_is_where_embree_finds_the_surface(name):
    """Within the error bound by which rays are moved off surfaces, at any time."""
    description = moving_scenes()[name]
    random = np.random.default_rng(2)
    origin = np.column_stack([random.uniform(-0.9, 0.9, (4000, 2)), np.full(4000, 8.0)])
    origin[:, :2] += description.instances.transform[-1 if name == "among others" else 0, :2, 3]
    times = random.random(4000)
    found, position, ng, ns, error = hits(description, origin, times)
    hit = found > 0.0
    assert hit.mean() > 0.5
    expected = origin[hit] + found[hit, None] * np.array([0.0, 0.0, -1.0])
    away = np.einsum("ij,ij->i", position[hit] - expected, ng[hit])  # off the surface, which is what rays must clear
    # The distance itself is known to its last bits only.
    assert (np.abs(away) < error[hit] + 2.0**-22 * found[hit]).all()
    assert np.allclose(position[hit], expected, atol=5e-4)
    assert np.allclose(np.linalg.norm(ng[hit], axis=1), 1.0, atol=1e-5) and np.array_equal(ng, ns)
    assert np.ptp(found[hit]) > 0.2


def test_times_beyond_the_ends_are_the_ends():
    description = quad_scene([at(0, 0, 0)])
    description.instances.motion[0] = steps(at(0, 0, 0), at(0, 0, 4))
    found, *_ = hits(description, [(0.5, -0.2, 10.0)] * 3, [0.0, 0.5, 1.0])
    assert np.allclose(found, (10.0, 8.0, 6.0), atol=1e-5)


@pytest.mark.parametrize("instance_count", [1, 2])
def test_smooth_normals_follow_the_shape(instance_count):
    description = deforming(quad_scene([at(0, 0, 0)] + [at(0, 0, -9)] * (instance_count - 1)), (0.0, 1.0))
    mesh = description.meshes[0]
    first, last = np.array([0.0, 0.0, 1.0]), np.array([0.6, 0.0, 0.8])
    mesh.corner_normals = np.broadcast_to(last, (2, 3, 3)).astype(np.float32)
    mesh.motion_normals = np.stack([np.broadcast_to(n, (2, 3, 3)) for n in (first, last)]).astype(np.float32)
    _, _, ng, ns, _ = hits(description, [(0.5, -0.2, 10.0)] * 3, [0.0, 0.5, 1.0])
    middle = (first + last) / np.linalg.norm(first + last)
    assert np.allclose(ns, [first, middle, last], atol=1e-5)
    # Half way up the corner (1, 1, h) of the triangle (-1, -1), (1, -1), (1, 1): its slope is h / 2 along y.
    slope = np.array([0.0, -0.25, 1.0])
    assert np.allclose(ng[1], slope / np.linalg.norm(slope), atol=1e-5)


def test_steps_that_do_not_fit_the_mesh_are_reported():
    for change in (np.zeros((3, 7, 3)), np.full((3, 4, 3), np.nan)):
        description = quad_scene([at(0, 0, 0)])
        description.meshes[0].motion_vertices = change.astype(np.float32)
        notices = []
        geometry, _ = built(description, notices)
        assert len(notices) == 1 and "keeps its shape" in notices[0].fallback
        assert len(geometry.motion_table) == 0


def test_motions_that_cannot_be_followed_are_reported():
    for motion in (np.full((3, 4, 4), np.nan), np.tile(np.eye(4), (130, 1, 1)), np.eye(4)[None]):
        description = quad_scene([at(0, 0, 0)])
        description.instances.motion[0] = motion.astype(np.float32)
        notices = []
        geometry, _ = built(description, notices)
        assert len(notices) == 1 and notices[0].subject == "object Quad 0" and "stands still" in notices[0].fallback
        assert len(geometry.motion_transforms) == 0
    description.instances.motion = {3: steps(np.eye(4), np.eye(4))}
    with pytest.raises(ValueError, match="of instance 3, and there are 1"):
        built(description)


@kernel
def _there_and_back(geometry, instance, time, v, out):
    p = point_to_object(geometry, instance, time, point_to_world(geometry, instance, time, v))
    d = direction_to_object(geometry, instance, time, direction_to_world(geometry, instance, time, v))
    n = normal_to_object(geometry, instance, time, normal_to_world(geometry, instance, time, v))
    for c in range(3):
        out[0, c] = p[c]
        out[1, c] = d[c]
        out[2, c] = n[c]


@pytest.mark.parametrize("instance", [0, 1])
def test_spaces_lead_there_and_back_at_any_time(instance):
    moves = steps(turned(0.0, position=(1, 2, 3), scale=(2, -1, 0.5)), turned(1.5, 1, (0, 5, 0), (1, -1, 3)))
    description = quad_scene([at(0, 1, 0, (2.0, 3.0, 1.0)), moves[0]])
    description.instances.motion[1] = moves
    geometry, _ = built(description)
    v = (np.float32(0.3), np.float32(-2.0), np.float32(1.1))
    out = np.zeros((3, 3), np.float32)
    for time in (0.0, 0.37, 1.0):
        _there_and_back(geometry, instance, np.float32(time), v, out)
        assert np.allclose(out, v, atol=1e-5)


# ---------------------------------------------------------------------------------------------------------------------
# Emitters


def moving_emitter(angle=1.2):
    description, info = light_probe.emissive_scene(
        [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)], [(0, 1, 2), (0, 2, 3)], mode=1
    )
    description.instances.motion[0] = steps(
        turned(math.pi - angle, 0, (-2, 0, 3)), turned(math.pi, 0, (0, 0, 3)), turned(math.pi + angle, 0, (2, 0, 3))
    )
    description.instances.transform = description.instances.motion[0][1:2]
    geometry = build_geometry(description, [], [])
    return build_lights(description, geometry, info, None), geometry


@pytest.mark.parametrize("time", [0.0, 0.21, 0.5, 1.0])
def test_moving_emitters_are_sampled_where_they_are(time):
    """Irradiance below by light sampling is that by uniform directions, and both agree about the density."""
    lights, geometry = moving_emitter()
    u = light_probe.stratified(40_000, seed=3)
    up = np.array([0.0, 0.0, 1.0], np.float32)
    samples = light_probe.draw(lights, geometry, (0, 0, 0), up, u, time=time)
    drawn = samples[samples[:, light_probe.PDF] > 0.0]
    again = light_probe.triangle_pdf(lights, geometry, drawn, (0, 0, 0), up, time=time)
    assert np.allclose(again, drawn[:, light_probe.PDF], rtol=2e-3)
    matrix = key(geometry.motion_transforms, time).astype(np.float64)
    # A fine grid over the square, as seen from the origin: cos cos dA / r^2, from its front only.
    s = (np.arange(400) + 0.5) / 200.0 - 1.0
    grid = np.stack(np.meshgrid(s, s), axis=-1).reshape(-1, 2)
    points = np.column_stack([grid, np.zeros(len(grid))]) @ matrix[:, :3].T + matrix[:, 3]
    normal = np.cross(matrix[:, 0], matrix[:, 1])
    squared = (points**2).sum(axis=1)
    cosines = np.maximum(points[:, 2], 0.0) * np.maximum(-(points @ normal), 0.0)
    expected = (cosines / squared**2).sum() * 4.0 / len(points)
    estimates = light_probe.irradiance(samples, up)
    error = estimates.std() / math.sqrt(len(estimates))
    assert expected > 0.05 and abs(estimates.mean() - expected) < 4.0 * error + 1e-3 * expected


def test_bounds_hold_an_emitter_at_all_times():
    lights, geometry = moving_emitter()
    assert is_in_motion(geometry, 0)
    places = np.concatenate(corners_in_motion(geometry, 0, np.arange(2))).reshape(-1, 3)
    center, radius = lights.sources[0, :3], math.sqrt(lights.sources[0, 3])
    assert (np.linalg.norm(places - center, axis=1) < radius).all()
    node = lights.nodes[0, :, 0]
    assert (np.abs(places - node[:3]) <= node[4:7] + 1e-4).all()
    assert math.acos(node[11]) > 1.2


def test_light_sampling_and_scattering_agree_about_a_moving_emitter():
    """With and without light sampling, and guided: the same means (Z-test of `benchmarks.bias`, 1e-4 each)."""
    description = emitter_scene()
    sampled = render_seeds(description, range(4), samples=512)
    scattered = render_seeds(description, range(10, 12), use_nee=False, samples=8192)
    bias = find_bias(scattered, sampled)
    assert not bias.is_biased and bias.detectable < 0.03, bias
    guided = render_seeds(description, range(20, 22), guiding_method="VMM", guiding_trial=False, samples=512)
    bias = find_bias(guided, sampled)
    assert not bias.is_biased and bias.detectable < 0.03, bias


@pytest.mark.parametrize(
    "mixture_u, is_moving", [("FREQUENCY", True), ("FREQUENCY", False), ("PLANES", True), ("HASH4D", True)]
)
def test_a_mixture_that_sees_the_time_is_unbiased_and_used_where_something_moves(
    mixture_u, is_moving, monkeypatch
):
    """A network with parameters drawn at random is as wrong as any can be."""
    seen = []

    def make(settings):
        seen.append(settings.mixture_u)
        return Untrained(settings, 4.0)

    monkeypatch.setattr(sets, "make_source_model", make)
    description = emitter_scene()
    if not is_moving:
        description.instances.motion.clear()
        description.meshes[1].motion_vertices = None
    guided = render_seeds(
        description, range(2), guiding_method="NPM", mixture_u=mixture_u, guiding_trial=False, samples=511
    )
    bias = find_bias(guided, render_seeds(description, range(10, 14), samples=512))
    assert not bias.is_biased and bias.detectable < 0.03, bias
    assert seen == [mixture_u if is_moving else "NONE"] * 2


@pytest.mark.parametrize("network_u", ["FREQUENCY", "PLANES"])
def test_a_network_that_weighs_by_the_time_is_unbiased(network_u, monkeypatch):
    """Whatever it says: its parameters are drawn at random (Z-test of `benchmarks.bias`, 1e-4)."""
    seen = guess(monkeypatch)
    description = emitter_scene()
    guided = render_seeds(
        description, range(2), guiding_method="NEURAL_RIS", network_u=network_u, guiding_trial=False, samples=511,
        candidate_allocation="FIXED", candidate_count=3,
    )
    bias = find_bias(guided, render_seeds(description, range(10, 14), samples=512))
    assert not bias.is_biased and bias.detectable < 0.03, bias
    assert [(settings.network_u, settings.u_dimension) for settings in seen] == [(network_u, "TIME")] * 2


def test_a_network_sees_no_time_where_nothing_moves(monkeypatch):
    """The picture does not depend on the setting, to the bit."""
    seen = guess(monkeypatch)
    description = floor_scene(lights=[sun()], size=(16, 12), transforms=[np.eye(4), turned(1.2, 0, (0, 3, 0))])
    images = [
        render_seeds(
            description, [1], guiding_method="NEURAL_RIS", network_u=network_u, guiding_trial=False, samples=15,
            candidate_allocation="FIXED", candidate_count=3, deterministic=True,
        )[0]
        for network_u in ("NONE", "FREQUENCY", "PLANES")
    ]  # fmt: skip
    assert [settings.network_u for settings in seen] == ["NONE"] * 3
    assert np.array_equal(images[0], images[1]) and np.array_equal(images[0], images[2])


def test_a_still_picture_is_the_mean_of_pictures_at_all_times():
    """A moving emitter's picture is the mean of those where it stands still, at the times of a fine grid."""
    description = emitter_scene()
    moving = render_seeds(description, range(2), samples=256)
    keys = interpolation_keys(description.instances.motion[1])
    still = []
    for k in range(16):
        time = (k + 0.5) / 16
        frozen = emitter_scene()
        frozen.instances.motion.clear()
        frozen.instances.transform[1, :3] = key(keys, time)
        square = frozen.meshes[1].motion_vertices
        frozen.meshes[1].vertices = square[0] + max(2.0 * time - 1.0, 0.0) * (square[2] - square[1])
        frozen.meshes[1].motion_vertices = None
        still.append(render_seeds(frozen, [100 + k], samples=64)[0])
    whole = np.mean(still, axis=0)
    assert np.mean(moving) == pytest.approx(whole.mean(), rel=0.01)
    cells = [
        image.mean(axis=-1).reshape(4, 3, 4, 4).mean(axis=(1, 3)) for image in (np.mean(moving, axis=0), whole)
    ]
    assert np.allclose(cells[0], cells[1], rtol=0.08)


# ---------------------------------------------------------------------------------------------------------------------
# Camera and shutter


def test_a_moving_camera_sees_what_a_moving_world_shows():
    """The camera goes one way, or the floor the other: the same picture, but for its noise's last bits."""
    checker = floor_scene(lights=[sun()], size=(24, 16), transforms=[turned(0.0, position=(50, 0, 0))])
    up = checker.camera.transform
    back = steps(*(at(50.0 + x, 0, 0) for x in (6.0, 0.0, -6.0)))
    moved = replace(checker, camera=replace(checker.camera, motion=steps(*(at(x, 0, 0) @ up for x in (-6, 0, 6)))))
    world = replace(checker, instances=replace(checker.instances, motion={0: back}))
    images = [render_seeds(description, [5], samples=16)[0] for description in (moved, world, checker)]
    assert np.allclose(images[0], images[1], atol=2e-3)
    assert np.abs(images[0] - images[2]).max() > 0.05


def test_static_scenes_do_not_depend_on_the_shutter():
    description = floor_scene(lights=[sun()], size=(16, 12))
    curve = np.linspace(0.0, 1.0, 9).astype(np.float32)
    images = [render_seeds(replace(description, shutter_curve=c), [1], samples=4)[0] for c in (None, curve)]
    assert np.array_equal(*images)


@kernel
def _times(table, u, out):
    for i in range(u.shape[0]):
        out[i] = sample_table(table, u[i])


@pytest.mark.parametrize("curve", [None, (0.0, 1.0, 0.0), (1.0, 0.2, 0.6, 0.0)])
def test_times_are_drawn_as_the_shutter_opens(curve):
    u = ((np.arange(20_000) + 0.5) / 20_000).astype(np.float32)
    times = np.zeros_like(u)
    _times(shutter_table(None if curve is None else np.array(curve, np.float32)), u, times)
    assert times.min() >= 0.0 and times.max() <= 1.0 and (np.diff(times) >= 0.0).all()
    edges = np.linspace(0.0, 1.0, 13)
    share = np.histogram(times, edges)[0] / len(u)
    fine = np.linspace(0.0, 1.0, 12_001)
    weight = np.ones_like(fine) if curve is None else np.interp(fine, np.linspace(0, 1, len(curve)), curve)
    expected = np.add.reduceat(0.5 * (weight[1:] + weight[:-1]), np.arange(0, 12_000, 1000))
    assert np.allclose(share, expected / expected.sum(), atol=0.006)


@pytest.mark.parametrize("curve", [np.zeros(4), np.full(4, np.nan)])
def test_a_shutter_that_never_opens_is_open_all_the_time(curve):
    assert np.array_equal(shutter_table(curve.astype(np.float32)), shutter_table(None))


def test_a_camera_that_moves_to_nowhere_is_refused():
    description = floor_scene(size=(8, 8))
    motion = steps(np.eye(4), np.full((4, 4), np.nan))
    session = Session(RenderSettings(samples=1, threads=1))
    with pytest.raises(ValueError, match="moves to NaN"):
        session.load(replace(description, camera=Camera(motion=motion)))


def test_sessions_notice_another_motion():
    """What is kept between frames is not kept where only a motion differs."""
    description = emitter_scene()
    session = Session(RenderSettings(samples=16, threads=1))
    images = []
    for factor in (1.0, -1.0):
        motion = description.instances.motion[1].copy()
        motion[:, 1, 3] = factor * np.array([0.0, 2.0, 4.0])
        session.load(replace(description, instances=replace(description.instances, motion={1: motion})))
        images.append(session.render().passes["Combined"])
    session.close()
    assert np.abs(images[0] - images[1]).mean() > 0.01


def test_lamps_and_sky_stand_still_beside_what_moves():
    """A scene of everything with a moving floor renders, and its rejects are none."""
    lamp = Light("lamp", "Lamp", "POINT", turned(0.0, position=(0, 0, 5)).astype(np.float32), (1.0, 1.0, 1.0), 100.0)
    description = floor_scene(lights=[lamp, sun()], world=World("w", "W", None, (0.1, 0.1, 0.1)), size=(16, 12))
    description.instances.motion[0] = steps(at(0, 0, -1), at(0, 0, 1))
    session = Session(RenderSettings(samples=8, threads=2))
    session.load(description)
    result = session.render()
    session.close()
    assert result.report.reject_count == 0 and np.isfinite(result.passes["Combined"]).all()
