# SPDX-License-Identifier: GPL-3.0-or-later
"""What the process tells the host."""

from __future__ import annotations

import numpy as np
import pytest

from engine.viewport.protocol import LARGEST_HALF, Block, Status


@pytest.fixture
def ends():
    """The host's and the process's end of one block."""
    host = Block.create()
    process = Block.attach(host.addresses)
    yield host, process
    # Both ends have the same descriptors here.
    host.close()


def test_a_status_arrives(ends) -> None:
    host, process = ends
    assert host.read_status() is None
    said = Status("RENDERING", "größer", 3, 64, 1.5, [("Cube", "is odd", "left out")], "chose mixtures")
    process.write_status(said)
    assert host.read_status() == said


def test_of_too_many_notices_the_last_are_left_out(ends) -> None:
    host, process = ends
    notices = [(f"Cube {number}", "x" * 200, "y" * 200) for number in range(1000)]
    process.write_status(Status("RENDERING", "goes on", notices=notices))
    read = host.read_status()
    assert read.message == "goes on"
    assert 10 < len(read.notices) < 1000 and read.notices == notices[: len(read.notices)]


def test_a_torn_status_is_seen(ends) -> None:
    host, process = ends
    process.write_status(Status("RENDERING", "a message"))
    memory = process.memories[0].map(1)
    at = memory.find(b"a message")
    memory[at] ^= 0xFF
    assert host.read_status() is None


def test_pictures_arrive_within_half_floats(ends) -> None:
    host, process = ends
    assert host.read_image() is None
    pixels = np.zeros((3, 5, 4), np.float32)
    pixels[0, 0] = (1e6, -1e9, np.nan, 1.0)
    pixels[2, 4] = (0.25, 0.5, 65504.0, np.inf)
    process.write_image(pixels, (0, 0, 10, 6), 2, 7)
    image = host.read_image()
    assert image.rectangle == (0, 0, 10, 6) and image.divider == 2 and image.update == 7 and image.number == 1
    assert image.pixels[0, 0].tolist() == [LARGEST_HALF, -LARGEST_HALF, 0.0, 1.0]
    assert image.pixels[2, 4].tolist() == [0.25, 0.5, 65504.0, LARGEST_HALF]
    assert np.isfinite(image.pixels.astype(np.float16)).all()


def test_pictures_of_any_size_follow_each_other(ends) -> None:
    host, process = ends
    for number, (width, height) in enumerate([(1, 1), (640, 360), (2, 3), (1000, 700), (1, 1)], 1):
        pixels = np.full((height, width, 4), number, np.float32)
        process.write_image(pixels, (0, 0, width, height), 1, number)
        image = host.read_image()
        assert image.number == number and np.array_equal(image.pixels, pixels)


def test_a_picture_that_is_overwritten_while_it_is_read_is_not_taken(ends, monkeypatch) -> None:
    host, process = ends
    process.write_image(np.ones((4, 4, 4), np.float32), (0, 0, 4, 4), 1, 1)
    images = host.memories[1]
    map_memory = images.map

    def map_slowly(size: int):
        """Two more pictures come between the look at what there is and its copy."""
        monkeypatch.setattr(images, "map", map_memory)
        for number in (2, 3):
            process.write_image(np.full((4, 4, 4), number, np.float32), (0, 0, 4, 4), 1, number)
        return map_memory(size)

    monkeypatch.setattr(images, "map", map_slowly)
    assert host.read_image() is None
    assert host.read_image().pixels[0, 0, 0] == 3.0
