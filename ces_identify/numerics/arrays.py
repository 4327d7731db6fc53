"""Types of arrays in annotations: B holds booleans, F floats, I integers."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

B = NDArray[np.bool_]
F = NDArray[np.float64]
I = NDArray[np.int64]  # noqa: E741
