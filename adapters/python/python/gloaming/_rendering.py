"""Arrays to frames and to light."""

from __future__ import annotations

import builtins
import itertools
from collections.abc import Iterable, Iterator
from typing import Any

import numpy as np
import numpy.typing as npt

from . import _gloaming
from ._frames import Frames
from ._gloaming import Frame
from ._scene import Document, Scene, document
from ._series import Series
from ._volume import Triple, extent, triple, volume


def render(
    series: Any,
    scene: Scene = None,
    *,
    size: tuple[int, int] | None = None,
    range: tuple[float, float] | None = None,
    spacing: Triple | None = None,
    origin: Triple | None = None,
    steps: Iterable[int] | None = None,
    times: Iterable[float] | None = None,
    device: str = "auto",
    threads: int = 0,
) -> Frame | Frames:
    """Lights and renders a volume, or a series of them.

    One volume with one camera gives a :class:`Frame`, everything else :class:`Frames`. A series is taken step by step: an array
    that is mapped from a file, an h5py dataset or a generator is never in memory as a whole.

    :param series: A volume (z, y, x), an array (t, z, y, x), an iterable of volumes, or an open :class:`Series`.
    :param scene: What to show, lit how, seen from where: the path of a scene file, its TOML text, or nested dictionaries.
    :param size: Width and height in pixels (``render.size``).
    :param range: Values that map to 0 and 1 of the transfer function (``field.range``). Where neither this nor the scene tells,
        it is that of all steps; of the steps so far where they can be had only once, as from a generator.
    :param spacing: World length between values along x, y, z, or one number for all; a :class:`Series` knows its own.
    :param origin: World position of the first value along x, y, z.
    :param steps: Step numbers; 0, 1, … unless given, or a :class:`Series` has its own.
    :param times: Physical times, as ``render.overlay = ["time"]`` shows them.
    :param device: ``auto`` (a hardware GPU where there is one, else the CPU), ``cpu``, ``gpu``, or part of an adapter's name.
    :param threads: Threads of the CPU; 0 is one per core.

    >>> import numpy as np, gloaming
    >>> frame = gloaming.render(np.ones((8, 8, 8)), "transfer.extinction = 0.2", size=(40, 30), range=(0, 1))
    >>> frame
    <gloaming.Frame of step 0, camera "main": 40×30 pixels>
    """
    seen = frames(
        series,
        scene,
        size=size,
        range=range,
        spacing=spacing,
        origin=origin,
        steps=steps,
        times=times,
        device=device,
        threads=threads,
    )
    gathered = Frames(seen)
    return gathered[0] if len(gathered) == 1 and _is_volume(series) else gathered


def frames(
    series: Any,
    scene: Scene = None,
    *,
    size: tuple[int, int] | None = None,
    range: tuple[float, float] | None = None,
    spacing: Triple | None = None,
    origin: Triple | None = None,
    steps: Iterable[int] | None = None,
    times: Iterable[float] | None = None,
    device: str = "auto",
    threads: int = 0,
) -> Iterator[Frame]:
    """:func:`render`, one frame at a time, so that none but the last has to be kept.

    >>> import numpy as np, gloaming
    >>> def simulation():
    ...     for n in range(3):
    ...         yield np.full((8, 8, 8), n, "float32")
    >>> for frame in gloaming.frames(simulation(), size=(32, 24), range=(0, 2)):
    ...     print(frame.step, frame.array.max() > 0)
    0 False
    1 True
    2 True
    """
    text = document(scene, **{"render.size": size, "field.range": range})
    for seen, _ in _lit(series, text, spacing, origin, steps, times, device, threads, light=False):
        yield from seen


def light(
    series: Any,
    scene: Scene = None,
    *,
    range: tuple[float, float] | None = None,
    spacing: Triple | None = None,
    origin: Triple | None = None,
    device: str = "auto",
    threads: int = 0,
) -> npt.NDArray[np.float32] | list[npt.NDArray[np.float32]]:
    """The illuminated volume: fluence per colour channel, shape (z, y, x, 3), float32; a list of them for a series.

    The light grid fills the same box as the data with ``light.resolution`` of its values along each axis, half of them unless
    the scene says otherwise. Other parameters are those of :func:`render`.

    >>> import numpy as np, gloaming
    >>> lit = gloaming.light(np.zeros((8, 12, 16)), {"lights": [{"intensity": 2.0}], "light": {"scattering": False}})
    >>> lit.shape, float(lit.max())                      # nothing is in the way
    ((4, 6, 8, 3), 2.0)
    """
    # The pictures that come with it are as small as they can be.
    text = document(scene, **{"render.size": (1, 1), "field.range": range})
    both = _lit(series, text, spacing, origin, None, None, device, threads, light=True)
    lit = [fluence for _, fluence in both if fluence is not None]
    return lit[0] if _is_volume(series) else lit


def _is_volume(series: Any) -> bool:
    if isinstance(series, Series):
        return False
    if hasattr(series, "ndim"):
        return bool(series.ndim != 4)
    # Nested lists of numbers are a volume; a list of arrays is a series, and so is what can only be iterated.
    return isinstance(series, (list, tuple)) and not any(hasattr(item, "ndim") for item in series) and np.ndim(series) == 3


def _lit(
    series: Any,
    scene: Document,
    spacing: Triple | None,
    origin: Triple | None,
    steps: Iterable[int] | None,
    times: Iterable[float] | None,
    device: str,
    threads: int,
    light: bool,
) -> Iterator[tuple[list[Frame], npt.NDArray[np.float32] | None]]:
    """Frames and light of each step."""
    if _is_volume(series):
        series = [series]
    between = triple(1.0 if spacing is None else spacing)
    corner = None if origin is None else triple(origin)
    numbers: Iterator[int] = itertools.count() if steps is None else iter(steps)
    moments: Iterator[float | None] = itertools.repeat(None) if times is None else iter(times)
    if isinstance(series, Series):
        between = between if spacing is not None else series.grid["spacing"]
        numbers = numbers if steps is not None else iter(series.steps)
        moments = moments if times is not None else iter(series.times)
    overall = _overall(series) if _gloaming.Session.wants_range(scene) else None
    session = _gloaming.Session(scene, overall, device, threads, light)
    for array, first in _volumes(series):
        step, time = _next(numbers, "steps"), _next(moments, "times")
        yield session.advance(volume(array), step, time, between, first if corner is None else corner)


def _volumes(series: Any) -> Iterator[tuple[Any, list[float]]]:
    """Each step's values, read when they are asked for, and where the first of them sits, which only files tell."""
    if isinstance(series, Series):
        return (series._read(index) for index in builtins.range(len(series)))
    return ((array, [0.0] * 3) for array in series)


def _overall(series: Any) -> tuple[float, float] | None:
    """The range of all steps, where they can be had twice."""
    if isinstance(series, Series) and (known := series.info()["range"]):
        (lo, hi), _ = known
        return lo, hi
    if not (hasattr(series, "__len__") and hasattr(series, "__getitem__")):
        return None
    found = [limits for array, _ in _volumes(series) if (limits := extent(volume(array)))]
    return (min(lo for lo, _ in found), max(hi for _, hi in found)) if found else None


def _next(values: Iterator[Any], name: str) -> Any:
    try:
        return next(values)
    except StopIteration:
        raise ValueError(f"{name}: fewer than the series has steps") from None
