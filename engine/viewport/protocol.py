# SPDX-License-Identifier: GPL-3.0-or-later
"""What the process tells the host: a block of shared memory that the host looks at whenever it likes.

The host never waits for the process, and needs no thread: it reads a block, and writes the next message only after the
block says that the last one was read. The process writes pictures into two slots of another shared memory by turns.
What is torn is seen and read again later: a status by its checksum, a picture by what has been written since.
"""

from __future__ import annotations

import json
import zlib
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from engine.array_types import Float32Array
from engine.processes.memory import PAGE, SharedMemory

#: Largest value that half floats hold, which textures of windows are made of; below the largest that rounds to it.
LARGEST_HALF = 65504.0

#: States of the process.
STARTING, WAITING, COMPILING, BUILDING, RENDERING, DONE, PAUSED, FAILED, DEAD = (
    "STARTING", "WAITING", "COMPILING", "BUILDING", "RENDERING", "DONE", "PAUSED", "FAILED", "DEAD"
)  # fmt: skip
#: Those in which there is nothing to wait for.
AT_REST = (WAITING, DONE, PAUSED, FAILED, DEAD)

_STATUS_BYTES = 16 * PAGE - 256
_SLOT_COUNT = 2
_PIXEL_BYTES = 16

_BLOCK = np.dtype(
    [
        # Number of the last update that was read, and of signs of life.
        ("received", np.int64),
        ("beat", np.int64),
        # Pictures that are whole, and the one that is being written: its number, where it lies and how large it is.
        ("image", np.int64),
        ("writing", np.int64),
        ("writing_start", np.int64),
        ("writing_size", np.int64),
        # Where the newest whole picture lies, and its size.
        ("start", np.int64),
        ("width", np.int64),
        ("height", np.int64),
        ("update", np.int64),
        ("rectangle", np.int64, (4,)),
        ("divider", np.int64),
        # JSON of a Status.
        ("status_length", np.int64),
        ("status_checksum", np.uint32),
        ("status", np.uint8, (_STATUS_BYTES,)),
    ]
)


@dataclass
class Status:
    """How a view stands.

    state, message : one of the states, and what users should read
    sample, samples : a pixel
    remaining : float or None [s]
    notices : list of (subject, problem, fallback)
    guiding : str, what guiding has come to
    update : int, number of the newest update that all this is about
    """

    state: str = STARTING
    message: str = ""
    sample: int = 0
    samples: int = 0
    remaining: float | None = None
    notices: list[tuple[str, str, str]] = field(default_factory=list)
    guiding: str = ""
    update: int = 0


@dataclass
class ViewImage:
    """A picture for a window.

    pixels : float32 (height, width, 4), scene-linear, premultiplied, within half floats' range, row 0 at the bottom
    rectangle : (x0, y0, x1, y1) of the window that it fills
    divider : int, pixels of the window that are one of these, in each direction
    update : int, number of the update that it shows
    number : int, of the picture
    """

    pixels: Float32Array
    rectangle: tuple[int, int, int, int]
    divider: int
    update: int
    number: int


class Block:
    """The block and the pictures, mapped. `create` in the host, `attach` in the process."""

    def __init__(self, block: SharedMemory, images: SharedMemory) -> None:
        self.memories = (block, images)
        self._images = images
        self._block: Any = np.frombuffer(block.map(_BLOCK.itemsize), _BLOCK, 1)
        self._image_count = 0

    @classmethod
    def create(cls) -> Block:
        """Reserve the memory.

        Raises
        ------
        OSError
            If there is not enough of it.
        """
        block = SharedMemory.create(-(-_BLOCK.itemsize // PAGE) * PAGE)
        try:
            return cls(block, SharedMemory.create(PAGE))
        except OSError:
            block.close()
            raise

    @classmethod
    def attach(cls, addresses: list[dict[str, Any]]) -> Block:
        """The process's end, from the host's `addresses`."""
        block, images = map(SharedMemory.attach, addresses)
        return cls(block, images)

    @property
    def addresses(self) -> list[dict[str, Any]]:
        """What the process needs for `attach`."""
        return [memory.address for memory in self.memories]

    def close(self) -> None:
        """Give the memory back."""
        self._block = None
        for memory in self.memories:
            memory.close()

    # The process writes

    def acknowledge(self, number: int) -> None:
        """Say that an update has been read: the memory that it lay in may be written again."""
        self._block["received"] = number

    def beat(self) -> None:
        """Say that the process's main thread is alive."""
        self._block["beat"] += 1

    def write_status(self, status: Status) -> None:
        """Replace the status; of very many notices the last are left out."""
        notices = list(status.notices)
        text = json.dumps(asdict(status)).encode()
        while len(text) > _STATUS_BYTES and notices:
            del notices[-max(len(notices) // 8, 1) :]
            text = json.dumps(asdict(status) | {"notices": notices}).encode()
        bytes_ = np.frombuffer(text[:_STATUS_BYTES], np.uint8)
        self._block["status_checksum"] = 0
        self._block["status"][0, : len(bytes_)] = bytes_
        self._block["status_length"] = len(bytes_)
        self._block["status_checksum"] = zlib.crc32(bytes_.data)

    def write_image(
        self, pixels: Float32Array, rectangle: tuple[int, int, int, int], divider: int, update: int
    ) -> None:
        """Publish a picture, float32 (height, width, 4) of any values: what a texture cannot hold is cut off.

        Raises
        ------
        OSError
            If there is not enough shared memory for pictures of this size.
        """
        height, width = pixels.shape[:2]
        size = height * width * _PIXEL_BYTES
        self._image_count = number = self._image_count + 1
        start = number % _SLOT_COUNT * size
        self._images.reserve(_SLOT_COUNT * size)
        for name, value in (("writing_start", start), ("writing_size", size), ("writing", number)):
            self._block[name] = value
        memory = self._images.map(_SLOT_COUNT * size)
        slot: Float32Array = np.ndarray((height, width, 4), np.float32, memory, start)
        np.clip(pixels, -LARGEST_HALF, LARGEST_HALF, out=slot)
        # A path that is not finite was left out long before: this is for what denoising makes.
        np.nan_to_num(slot, copy=False, nan=0.0)
        # No picture, while what is said of it changes.
        self._block["image"] = 0
        for name, value in (
            ("start", start), ("width", width), ("height", height), ("update", update), ("divider", divider),
        ):  # fmt: skip
            self._block[name] = value
        self._block["rectangle"] = rectangle
        self._block["image"] = number

    # The host reads

    @property
    def received(self) -> int:
        """Number of the last update that was read, 0 = none."""
        return int(self._block["received"][0])

    @property
    def beat_count(self) -> int:
        """Grows as long as the process's main thread is alive and has work."""
        return int(self._block["beat"][0])

    @property
    def image_number(self) -> int:
        """Number of the newest picture; 0 = there is none, or none can be read now."""
        return int(self._block["image"][0])

    def read_status(self) -> Status | None:
        """A copy of the status; None if it is being written, or never was."""
        text = bytes(self._block["status"][0, : int(self._block["status_length"][0])])
        if not text or zlib.crc32(text) != int(self._block["status_checksum"][0]):
            return None
        status = Status(**json.loads(text))
        status.notices = [(subject, problem, fallback) for subject, problem, fallback in status.notices]
        return status

    def read_image(self) -> ViewImage | None:
        """A copy of the newest picture; None if there is none, or it is torn.

        Raises
        ------
        OSError
            If there is no room for it in this process.
        """
        fields = self._block[0].copy()
        number, width, height = int(fields["image"]), int(fields["width"]), int(fields["height"])
        start, size = int(fields["start"]), width * height * _PIXEL_BYTES
        if number == 0 or self._images.size < start + size:
            return None
        memory = self._images.map(start + size)
        slot: Float32Array = np.ndarray((height, width, 4), np.float32, memory, start)
        pixels = slot.copy()
        del slot
        now = self._block[0]
        if int(now["image"]) not in (number, number + 1):
            return None
        written = int(now["writing"]) - number
        begin, end = int(now["writing_start"]), int(now["writing_start"]) + int(now["writing_size"])
        if written > 1 or (written == 1 and begin < start + size and start < end):
            return None
        x0, y0, x1, y1 = fields["rectangle"].tolist()
        return ViewImage(pixels, (x0, y0, x1, y1), int(fields["divider"]), int(fields["update"]), number)
