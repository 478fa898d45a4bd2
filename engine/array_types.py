# SPDX-License-Identifier: GPL-3.0-or-later
"""Types of arrays by element, for annotations everywhere."""

import numpy as np
import numpy.typing as npt

Float32Array = npt.NDArray[np.float32]
Int16Array = npt.NDArray[np.int16]
Int32Array = npt.NDArray[np.int32]
Int64Array = npt.NDArray[np.int64]
Uint8Array = npt.NDArray[np.uint8]
Uint32Array = npt.NDArray[np.uint32]
IntpArray = npt.NDArray[np.intp]
FloatArray = npt.NDArray[np.float64]
