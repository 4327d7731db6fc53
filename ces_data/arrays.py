"""Types of the arrays in signatures: F holds floats, I integers, a mask booleans."""

import numpy as np
from numpy.typing import NDArray

F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741
Mask = NDArray[np.bool_]
