# SPDX-License-Identifier: GPL-3.0-or-later
"""What importing the engine leaves undone until a kernel is needed."""

import subprocess
import sys

from engine.kernels.vector import dot
from engine.runtime.jit import Kernel

_COUNT = """
import gc
import engine.render.session
from engine.runtime.jit import Kernel
from engine.runtime.kernel_cache import origins
kernels = [thing for thing in gc.get_objects() if type(thing) is Kernel]
print(len(kernels), sum(kernel.is_made for kernel in kernels), sum(origins.values()))
"""


def test_importing_the_engine_makes_no_dispatcher_and_loads_no_kernel() -> None:
    """So that Blender starts as soon as before, and a first render too where a library holds its kernels."""
    done = subprocess.run([sys.executable, "-c", _COUNT], capture_output=True, text=True, check=True)
    kernels, made, loaded = (int(word) for word in done.stdout.split())
    assert kernels > 500
    assert made == 0
    assert loaded == 0


def test_a_kernel_is_made_once_and_knows_its_function() -> None:
    assert isinstance(dot, Kernel)
    assert dot.dispatcher is dot.dispatcher
    assert dot.is_made
    assert dot.__name__ == dot.py_func.__name__ == "dot"
    assert dot.__doc__ == dot.py_func.__doc__
