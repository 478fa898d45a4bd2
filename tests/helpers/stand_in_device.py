# SPDX-License-Identifier: GPL-3.0-or-later
"""What stands in for a GPU: torch on the processor, by the code of devices that torch does all on."""

from engine.guiding.neural.worker.devices import Device

STAND_IN = Device("stand-in", "cpu", is_apart=True)
