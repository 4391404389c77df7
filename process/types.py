"""Types of arrays, for annotations in every package."""

import numpy as np
from numpy.typing import NDArray

Real = NDArray[np.float64]
"""Array of real numbers."""

Complex = NDArray[np.complex128]
"""Array of complex numbers."""
