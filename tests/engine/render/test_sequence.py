# SPDX-License-Identifier: GPL-3.0-or-later
"""One field for a sequence of frames: trained once, used by all of them, and none is biased by it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.bias import find_bias
from engine.guiding.fields.vmm.field import allocate_guide
from engine.guiding.models import record_sink
from engine.guiding.neural.models import network_source
from engine.guiding.neural.networks.lobes.vmf import decode_vmf
from engine.guiding.neural.networks.mixture.inference import allocate_mixture_scratch, evaluate_mixtures
from engine.guiding.records.training_rows import ROW_U
from engine.guiding.records.vertices import VertexRecords, allocate_vertex_records
from engine.guiding.sources.sequence import u_span
from engine.render import sequence
from engine.render.sequence import LoadCancelled, TrainingFailed, train_sequence
from engine.render.session import Session
from engine.scene.description import VISIBLE_CAMERA, Frame
from engine.scene.digest import camera_digest, light_digest
from engine.scene.instances import plain_instances
from engine.settings import RenderSettings
from tests.helpers.guiding_harness import densities, sphere_grid
from tests.helpers.small_scenes import floor_scene, material
from tests.helpers.training import refuse_workers, require_torch

FRAMES = (1, 24)
#: Where the lamp hangs in each frame [m].
LAMPS = {1: (-1.6, 0.0, 1.2), 24: (1.6, 0.0, 1.2)}
SETTINGS = RenderSettings(
    guiding_method="NPM", mixture_u="PLANES", use_nee=False, threads=2, max_bounces=3, guiding_trial=False,
    learn_guiding_probability=False, light_sampling_threshold=0.0, filter_glossy=0.0,
)


def lamp_scene(frame, size=(32, 24)):
    """A floor under a small glowing square that hangs somewhere else in each frame."""
    glow = material("Glow", (30.0, 30.0, 30.0), "ShaderNodeEmission")
    description = floor_scene(size=size, materials=[material(), glow])
    lamp = np.diag([0.006, -0.006, -1.0, 1.0])
    lamp[:3, 3] = LAMPS[frame]
    description.instances = plain_instances([np.diag([0.08, 0.08, 1.0, 1.0]), lamp], name="Floor")
    description.instances.material_offset[:] = (0, 1)
    description.instances.materials = np.array([0, 1], np.int32)
    # Its edges would be most of the noise.
    description.instances.visibility[1] &= ~np.uint32(VISIBLE_CAMERA)
    description.camera.transform[2, 3] = 8.0
    description.frame_current = float(frame)
    return description


def rendered(description, field, seed, **settings):
    session = Session(replace(SETTINGS, **{"samples": 31, "seed": seed, **settings}))
    session.load(description)
    source = None if field is None else field.source(session.settings, description)
    result = session.render(source=source)
    session.close()
    return result


@pytest.fixture(scope="module")
def field():
    require_torch()
    scenes = [lamp_scene(frame) for frame in FRAMES]
    return train_sequence(replace(SETTINGS, deterministic=True), scenes, FRAMES, samples=96)


def density_towards(network, shape, target, u):
    """Mean density [sr^-1] of the mixtures on the floor within a cone around where `target` is seen."""
    position = np.array([(x, y, 0.0) for x in (-0.5, 0.0, 0.5) for y in (-0.5, 0.5)], np.float32)
    count = len(position)
    up = np.tile(np.float32((0.0, 0.0, 1.0)), (count, 1))
    raw = np.zeros((count, shape.output_width), np.float32)
    evaluate_mixtures(
        network, position, up, up, np.ones(count, np.float32), np.full(count, u, np.float32), count,
        allocate_mixture_scratch(shape), raw,
    )
    guide = allocate_guide(1)
    grid = sphere_grid(100, 200)
    found = []
    for row in range(count):
        decode_vmf(raw, row, 0, shape.lobe_count, guide, 0, np.float32(1.0))
        axis = np.asarray(target) - position[row]
        is_near = grid @ (axis / np.linalg.norm(axis)) > np.cos(0.3)
        found.append(densities(guide, grid[is_near])[0].mean())
    return float(np.mean(found))


def test_each_time_has_its_own_lamp(field):
    """At u of a frame the mixture points to that frame's lamp, hardly to the other's."""
    for frame, other in (FRAMES, FRAMES[::-1]):
        source = field.source(SETTINGS, lamp_scene(frame))
        (u, closing) = u_span(lamp_scene(frame), field.span)
        assert u == closing == (0.0 if frame == FRAMES[0] else 1.0)
        own = density_towards(source.field, field.shape, LAMPS[frame], u)
        others = density_towards(source.field, field.shape, LAMPS[other], u)
        # A tenth of a sphere's share would be uniform.
        assert own > 5.0 * others and own > 5.0 * 0.25 / np.pi


def test_frames_are_rendered_by_the_field_without_bias(field, monkeypatch):
    """No worker is started, the network stays what it was, and the mean is that of an unguided render."""
    monkeypatch.setattr(network_source, "NetworkTrainer", None)
    for frame in FRAMES:
        scene = lamp_scene(frame)
        guided = [rendered(scene, field, seed) for seed in range(8)]
        for result in guided:
            network = result.guidance.source
            assert network.u_span.tolist() == [float(frame == FRAMES[1])] * 2
            arrays = field.shape.split(field.snapshot.parameters)
            assert np.shares_memory(network.encoding.planes, arrays["planes"])
            assert "trained once for times 1 to 24" in result.report.guiding.source
            assert result.report.guiding.source_seconds == 0.0
        images = [result.passes["Combined"] for result in guided]
        plain = [
            rendered(scene, None, seed, guiding_method="OFF", samples=512).passes["Combined"] for seed in range(10, 14)
        ]
        bias = find_bias(images, plain)
        assert not bias.is_biased and bias.detectable < 0.1, bias
        # It is of use: far less noise in most pixels than as many unguided samples have.
        few = [rendered(scene, None, seed, guiding_method="OFF").passes["Combined"] for seed in range(20, 28)]
        assert np.median(np.var(images, axis=0)[..., 0]) < 0.5 * np.median(np.var(few, axis=0)[..., 0])


def test_a_cancel_ends_the_training():
    asked = []

    def should_cancel():
        asked.append(None)
        return len(asked) > 3

    messages = []
    with pytest.raises(LoadCancelled):
        train_sequence(
            SETTINGS, [lamp_scene(frame) for frame in FRAMES], FRAMES, samples=1 << 20,
            on_progress=lambda progress: messages.append(progress.message), should_cancel=should_cancel,
        )
    assert messages[0] == "Training the sequence's field: frame 1 (1 of 38 visits)" and len(messages) < 9


@pytest.mark.parametrize(
    ("settings", "span", "message"),
    [
        ({"guiding_method": "VMM"}, FRAMES, "VMM is no neural mixture"),
        ({"guiding_method": "OFF"}, FRAMES, "nothing is guided"),
        ({}, (3.0, 3.0), "has no length"),
    ],
)
def test_what_cannot_be_trained_is_refused(settings, span, message):
    with pytest.raises(ValueError, match=message):
        train_sequence(replace(SETTINGS, **settings), [lamp_scene(1)], span, samples=1)


def test_a_worker_that_is_lost_is_named(monkeypatch):
    refuse_workers(monkeypatch)
    with pytest.raises(TrainingFailed, match="no process"):
        train_sequence(SETTINGS, [lamp_scene(frame) for frame in FRAMES], FRAMES, samples=1)


def test_a_field_of_other_settings_is_refused(field):
    with pytest.raises(ValueError, match="train it anew"):
        field.source(replace(SETTINGS, guiding_method="NASG"), lamp_scene(1))


def test_frames_have_their_parts_of_u():
    description = lamp_scene(1)
    description.frame_current = 13.0
    assert u_span(description, (1.0, 25.0)) == (0.5, 0.5)
    description.shutter = (12.5, 14.5)
    np.testing.assert_allclose(u_span(description, (0.5, 24.5)), (0.5, 7.0 / 12.0))
    description.shutter = (-1.0, 30.0)
    assert u_span(description, (0.5, 24.5)) == (0.0, 1.0)


def test_rows_are_of_the_same_u_that_the_network_is_asked_with():
    records = VertexRecords(*(column[:3] for column in allocate_vertex_records(3)))
    records.pdf[:] = records.bsdf_pdf[:] = records.guide_pdf[:] = 1.0
    records.time[:] = (0.0, 0.5, 1.0)
    rows = record_sink.training_rows(records, 3, (0.25, 0.75))
    np.testing.assert_array_equal(rows[:, ROW_U], (0.25, 0.5, 0.75))
    np.testing.assert_array_equal(record_sink.training_rows(records, 3)[:, ROW_U], records.time)


def test_training_is_spread_over_frames_and_visits():
    assert sequence.training_frames(3, 5) == [3, 4, 5]
    frames = sequence.training_frames(1, 250)
    assert len(frames) == sequence.MOST_TRAINING_FRAMES and (frames[0], frames[-1]) == (1, 250)
    for samples in (1, 2, 16, 100):
        lengths = sequence.visit_lengths(samples)
        assert sum(lengths) == samples and lengths[0] == 1 and lengths == sorted(lengths)
    assert sequence.visit_lengths(16) == [1, 3, 12]


def test_large_frames_are_visited_in_small():
    frame = Frame(32, 16, (0, 0, 32, 16))
    assert sequence.shrunk(frame) is frame
    small = sequence.shrunk(Frame(3840, 2160, (1920, 1080, 3840, 2160)))
    x0, y0, x1, y1 = small.region
    assert 0.9 * sequence.MOST_PIXELS < (x1 - x0) * (y1 - y0) <= 1.01 * sequence.MOST_PIXELS
    assert small.width / small.height == pytest.approx(16 / 9, rel=0.01)
    assert x0 / small.width == pytest.approx(0.5, rel=0.01)
    assert small.width - x1 in (0, 1) and small.height - y1 in (0, 1)
    sliver = sequence.shrunk(Frame(100_000, 1, (0, 0, 100_000, 1)))
    assert sliver.region[3] == 1 and sliver.region[2] <= sliver.width


def test_digests_see_what_changes():
    scene, other = lamp_scene(1), lamp_scene(24)
    assert light_digest(scene) == light_digest(lamp_scene(1)) != light_digest(other)
    assert camera_digest(scene) == camera_digest(other)
    other = lamp_scene(1)
    other.camera.transform[0, 3] = 1.0
    assert camera_digest(other) != camera_digest(scene) and light_digest(other) == light_digest(scene)
    other.materials[1] = material("Glow", (31.0, 30.0, 30.0), "ShaderNodeEmission")
    assert light_digest(other) != light_digest(scene)
    assert sequence.has_changing_light([scene, other]) and not sequence.has_changing_light([scene, lamp_scene(1)])
    moving = lamp_scene(1)
    moving.instances.motion[1] = np.stack([scene.instances.transform[1]] * 2)
    assert sequence.has_changing_light([moving])
