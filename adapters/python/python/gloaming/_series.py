"""Series of files."""

from __future__ import annotations

import json
import os
from collections.abc import Iterable, Iterator
from typing import Any, Union

import numpy as np
import numpy.typing as npt

from . import _gloaming
from ._volume import Triple, triple

_Path = Union[str, "os.PathLike[str]"]


def open(
    series: _Path | Iterable[_Path],
    *,
    field: str | None = None,
    component: str | int | None = None,
    axes: str | None = None,
    spacing: Triple | None = None,
    origin: Triple | None = None,
    time_step: float | None = None,
    raw: str | None = None,
    level: int | None = None,
) -> Series:
    """Opens a series of timesteps in files: HDF5 in many layouts, XDMF, NRRD, MetaImage, VTK images, raw files. Meshes of
    several levels are brought to one, uneven axes to even ones.

    :param series: A file, several, a directory, a glob or a pattern such as ``run/plt_{step:05}.h5``; ``FILE:/dataset`` names
        a dataset outright.
    :param field: Field or dataset to read, where there are several.
    :param component: Of a vector field: ``x``, ``y``, ``z``, an index, or ``magnitude``, which is the default.
    :param axes: Axes of the dataset, slowest first, of x y z t c.
    :param spacing: World length between values along x, y, z, instead of the file's.
    :param origin: World position of the first value, instead of the file's.
    :param time_step: Physical time between steps, instead of the file's times.
    :param raw: Layout of headerless files, such as ``dims=96x96x96,dtype=f64le,offset=24,order=zyx,steps=12``.
    :param level: Level of refinement to bring a mesh to, 0 the coarsest, instead of the finest.

    >>> import h5py, numpy as np, os, tempfile, gloaming
    >>> run = os.path.join(tempfile.mkdtemp(), "run.h5")
    >>> with h5py.File(run, "w") as file:
    ...     _ = file.create_dataset("density", data=np.random.default_rng(1).random((3, 4, 5, 6)))
    >>> series = gloaming.open(run)
    >>> series, series.info()["field"], series.steps
    (<gloaming.Series: 3 steps of density, 6×5×4>, 'density', [0, 1, 2])
    >>> series.read(2).shape
    (4, 5, 6)
    >>> frames = gloaming.render(series, size=(32, 24))
    """
    files = [series] if isinstance(series, (str, os.PathLike)) else list(series)
    native = _gloaming.Series(
        [os.fspath(file) for file in files],
        field,
        None if component is None else str(component),
        axes,
        (None if spacing is None else triple(spacing), None if origin is None else triple(origin), time_step),
        raw,
        level,
    )
    return Series(native)


class Series:
    """An open series; :func:`open` makes it. Iterating gives each step's values in turn."""

    def __init__(self, native: _gloaming.Series) -> None:
        self._native = native
        self._info: dict[str, Any] = json.loads(native.info())

    def info(self) -> dict[str, Any]:
        """What was found: layout, files, field and candidates, grid (``size``, ``spacing`` and ``origin`` along x, y, z), steps
        with their times, warnings."""
        copy: dict[str, Any] = json.loads(json.dumps(self._info))
        return copy

    @property
    def steps(self) -> list[int]:
        """Step numbers, in order."""
        return [step["step"] for step in self._info["steps"]]

    @property
    def times(self) -> list[float | None]:
        """Physical times, ``None`` where they are not known."""
        return [step["time"] for step in self._info["steps"]]

    @property
    def grid(self) -> dict[str, Any]:
        """The grid of the values that are read: ``size``, ``spacing`` and ``origin`` along x, y, z."""
        grid: dict[str, Any] = self._info["resampled"] or self._info["grid"]
        return grid

    def read(self, step: int, dtype: Any = np.float32) -> npt.NDArray[Any]:
        """The values of a step by its number, (z, y, x), as float32 or float64; NaN where there are none.

        :raises LookupError: There is no such step.
        """
        return self._read(self._index(step), dtype)[0]

    def _index(self, step: int) -> int:
        try:
            return self.steps.index(step)
        except ValueError:
            first, last = self.steps[0], self.steps[-1]
            raise LookupError(f"no step {step} among the {len(self)}, which are numbered {first} to {last}") from None

    def _read(self, index: int, dtype: Any = np.float32) -> tuple[npt.NDArray[Any], list[float]]:
        if np.dtype(dtype) == np.float64:
            return self._native.read_f64(index)
        values, origin = self._native.read(index)
        return values.astype(dtype, copy=False), origin

    def __len__(self) -> int:
        return len(self._info["steps"])

    def __iter__(self) -> Iterator[npt.NDArray[Any]]:
        return (self._read(index)[0] for index in range(len(self)))

    def __repr__(self) -> str:
        size = "×".join(map(str, self.grid["size"]))
        return f"<gloaming.Series: {len(self)} steps of {self._info['field']}, {size}>"
