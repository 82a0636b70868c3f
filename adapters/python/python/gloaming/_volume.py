"""What people hand over as volumes, as NumPy arrays."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Union

import numpy as np
import numpy.typing as npt

#: Three numbers along x, y, z, or one for all.
Triple = Union[float, Iterable[float]]


def volume(array: Any) -> npt.NDArray[Any]:
    """The array itself where it is one; masked values become holes."""
    values: npt.NDArray[Any]
    if isinstance(array, np.ma.MaskedArray):
        wide = array.dtype.itemsize > 4 or array.dtype.kind not in "f"
        values = np.ma.filled(array.astype(np.float64 if wide else np.float32), np.nan)
    else:
        values = np.asarray(array)
    return values


def triple(value: Triple) -> list[float]:
    """Along x, y, z."""
    if isinstance(value, Iterable):
        numbers = [float(v) for v in value]
        if len(numbers) != 3:
            raise ValueError(f"{numbers}: three numbers, along x, y, z, or one for all")
        return numbers
    return [float(value)] * 3


def extent(array: npt.NDArray[Any]) -> tuple[float, float] | None:
    """The least and greatest finite value."""
    if array.dtype.kind == "f":
        array = array[np.isfinite(array)]
    return (float(array.min()), float(array.max())) if array.size else None
