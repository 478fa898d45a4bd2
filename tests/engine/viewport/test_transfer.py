# SPDX-License-Identifier: GPL-3.0-or-later
"""Updates through shared memory."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from engine.processes.memory import PAGE, SharedMemory
from engine.scene.content import same_content
from engine.scene.description import Image, SceneDescription
from engine.viewport.transfer import Receiver, Sender
from engine.viewport.view import Update
from tests.helpers.small_scenes import floor_scene


@pytest.fixture
def ends():
    """Sender and receiver of one memory."""
    memory = SharedMemory.create(PAGE)
    yield Sender(memory), Receiver(memory)
    memory.close()


def picture(name: str, seed: int) -> Image:
    pixels = np.random.default_rng(seed).uniform(0.0, 1.0, (64, 64, 4)).astype(np.float32)
    return Image((name, seed), name, pixels, "LINEAR")


def scene(*images: Image) -> SceneDescription:
    return replace(floor_scene(), images=list(images))


def test_a_scene_arrives_as_it_was(ends) -> None:
    sender, receiver = ends
    sent = scene(picture("a", 1))
    received = receiver.read(sender.write(Update(scene=sent)))
    assert same_content(received.scene, sent)
    assert received.view is None


def test_arrays_that_are_known_are_named_only(ends) -> None:
    sender, receiver = ends
    first = scene(picture("a", 1), picture("b", 2))
    size = sender.write(Update(scene=first))
    before = receiver.read(size).scene
    second = replace(first, images=[first.images[0], picture("b", 3)])
    smaller = sender.write(Update(scene=second))
    after = receiver.read(smaller).scene
    one = first.images[0].pixels.nbytes
    assert size > 2 * one and one < smaller < 1.5 * one + 20000
    assert after.images[0].pixels is before.images[0].pixels
    assert same_content(after, second)


def test_arrays_that_are_not_used_any_more_are_forgotten(ends) -> None:
    sender, receiver = ends
    kept = picture("a", 1)
    receiver.read(sender.write(Update(scene=scene(kept, picture("b", 2)))))
    receiver.read(sender.write(Update(scene=scene(kept))))
    again = scene(kept, picture("b", 2))
    assert same_content(receiver.read(sender.write(Update(scene=again))).scene, again)


def test_a_camera_alone_is_small_and_forgets_nothing(ends) -> None:
    sender, receiver = ends
    sent = scene(picture("a", 1))
    receiver.read(sender.write(Update(scene=sent)))
    assert sender.write(Update(is_paused=True)) < 2000
    receiver.read(sender.write(Update(is_paused=True)))
    assert sender.write(Update(scene=sent)) < sent.images[0].pixels.nbytes


def test_arrays_in_any_order_of_memory_arrive(ends) -> None:
    sender, receiver = ends
    image = picture("a", 1)
    turned = Image("t", "t", image.pixels[::-1, ::2], "LINEAR")
    received = receiver.read(sender.write(Update(scene=scene(turned))))
    assert np.array_equal(received.scene.images[0].pixels, turned.pixels)


def test_the_memory_is_given_back(ends) -> None:
    sender, receiver = ends
    receiver.read(sender.write(Update(scene=scene(picture("a", 1)))))
    sender.give_back()
    assert receiver.read(sender.write(Update(is_paused=False))).is_paused is False
