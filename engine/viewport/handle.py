# SPDX-License-Identifier: GPL-3.0-or-later
"""The host's handle on the process that renders a view. It never waits for the process, needs no thread, never raises.

Whatever goes wrong with the process ends in a `Status` whose state is DEAD, with a message for users.
"""

from __future__ import annotations

import time
from dataclasses import replace
from typing import Any

from engine.processes.child import ENTRY, Child
from engine.processes.interpreter import find_interpreter
from engine.processes.memory import SharedMemory
from engine.viewport.protocol import AT_REST, COMPILING, DEAD, STARTING, Block, Status, ViewImage
from engine.viewport.transfer import Sender
from engine.viewport.view import Update

_SERVICE = "viewport.service"
_FIRST_BYTES = 1 << 16
#: The memory that updates lie in is given back where it is larger than this.
_KEPT_BYTES = 1 << 20
#: Time between two looks at the process that counts as its silence at most [s].
_LONGEST_LOOK = 1.0


class ViewProcess:
    """A process that renders one view at a time.

    Parameters
    ----------
    interpreter : str or None
        Python for the process; None: what `find_interpreter` finds.
    start_timeout, answer_timeout : float [s]
        Silence after which the process counts as hung, while it starts and later.

    Attributes
    ----------
    script : Path
        What the process runs; before `start` it may be replaced by anything that speaks the same protocol.
    status : Status, as last seen
    """

    def __init__(
        self, interpreter: str | None = None, start_timeout: float = 60.0, answer_timeout: float = 20.0
    ) -> None:
        self.script = ENTRY
        self.status = Status()
        self._interpreter = interpreter or find_interpreter()
        self._start_timeout = start_timeout
        self._answer_timeout = answer_timeout
        self._child: Child | None = None
        self._block: Block | None = None
        self._transfer: SharedMemory | None = None
        self._sender: Sender | None = None
        self._pending: Update | None = None
        self._sent = 0
        #: Where an update lies that the process has not read yet, or not yet given back: its size in bytes.
        self._lent = 0
        self._shown = 0
        self._beat = 0
        self._silence = self._looked = 0.0

    @property
    def is_alive(self) -> bool:
        """Whether there is a process to send to."""
        return self._child is not None

    @property
    def process_id(self) -> int | None:
        """Identifier of the process, for tests and measurements."""
        return None if self._child is None else self._child.process.pid

    @property
    def sent(self) -> int:
        """Number of the newest update that was sent; a picture says which it shows."""
        return self._sent

    @property
    def is_waiting(self) -> bool:
        """Whether something will come: a picture, or another state."""
        status = self.status
        is_behind = self._pending is not None or status.update < self._sent
        return self.is_alive and (is_behind or status.state not in AT_REST)

    @property
    def _is_read(self) -> bool:
        return self._block is not None and self._block.received >= self._sent

    def start(self) -> None:
        """Start the process, and return at once."""
        if self._child is not None:
            return
        self.status = Status()
        self._sent = self._lent = self._shown = 0
        self._beat, self._silence, self._looked = 0, 0.0, time.monotonic()
        if self._interpreter is None:
            self._die("There is no Python to start the viewport's process with")
            return
        try:
            self._block = Block.create()
            self._transfer = SharedMemory.create(_FIRST_BYTES)
        except OSError as error:
            self._die(f"No shared memory for the viewport: {error.strerror or error}")
            return
        self._sender = Sender(self._transfer)
        config: dict[str, Any] = {"block": self._block.addresses, "transfer": self._transfer.address}
        memories = (*self._block.memories, self._transfer)
        try:
            self._child = Child(
                self._interpreter, _SERVICE, config, memories=memories, has_answers=False, is_background=True,
                has_same_path=True, script=self.script,
            )
        except OSError as error:
            self._die(f"The viewport's process could not be started: {error.strerror or error}")

    def send(self, update: Update) -> None:
        """Have the process render what has changed. Where it is still reading, all that comes meanwhile goes as one."""
        self._pending = update if self._pending is None else self._pending.then(update)
        self._flush()

    def _flush(self) -> None:
        if self._child is None or self._sender is None or not self._is_read:
            return
        if self._lent > _KEPT_BYTES:
            self._sender.give_back()
        self._lent = 0
        if self._pending is None:
            return
        update, self._pending = self._pending, None
        try:
            size = self._sender.write(update)
        except (OSError, MemoryError) as error:
            self._die(f"No shared memory for the scene: {getattr(error, 'strerror', None) or error}")
            return
        self._sent += 1
        self._lent = size
        self._child.send(kind="update", number=self._sent, size=size)

    def poll(self) -> Status:
        """How the view stands; sends what waits."""
        child, block = self._child, self._block
        if child is None or block is None:
            return self.status
        code = child.process.poll()
        if code is not None:
            self._die(f"The viewport's process {child.reason(code)}")
            return self.status
        status = block.read_status()
        if status is not None:
            self.status = status
        self._flush()
        self._watch(block)
        return self.status

    def _watch(self, block: Block) -> None:
        """A process that is to do something and has not moved for too long is hung."""
        now = time.monotonic()
        # Where nobody has looked for long the whole machine may have slept.
        self._silence += min(now - self._looked, _LONGEST_LOOK)
        self._looked = now
        if block.beat_count != self._beat or not self.is_waiting:
            self._beat, self._silence = block.beat_count, 0.0
            return
        limit = self._start_timeout if self.status.state in (STARTING, COMPILING) else self._answer_timeout
        if self._silence > limit:
            self._die(f"The viewport's process has not answered for {self._silence:.0f} s", is_patient=False)

    def read_image(self) -> ViewImage | None:
        """The newest picture, if it was not read before."""
        if self._block is None or self._block.image_number in (0, self._shown):
            return None
        try:
            image = self._block.read_image()
        except (OSError, MemoryError) as error:
            self._die(f"No memory for the viewport's picture: {getattr(error, 'strerror', None) or error}")
            return None
        if image is not None:
            self._shown = image.number
        return image

    @property
    def has_image(self) -> bool:
        """Whether there is a picture that was not read."""
        return self._block is not None and self._block.image_number not in (0, self._shown)

    def close(self) -> None:
        """End the process and give its memory back."""
        self._die("")

    def _die(self, reason: str, *, is_patient: bool = True) -> None:
        """End of the process, whatever state it is in."""
        self.status = replace(self.status, state=DEAD, message=reason)
        child, self._child = self._child, None
        block, self._block = self._block, None
        transfer, self._transfer = self._transfer, None
        self._sender = self._pending = None
        if child is not None:
            child.close(is_patient=is_patient)
            child.release()
        for memory in (block, transfer):
            if memory is not None:
                memory.close()
