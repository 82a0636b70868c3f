"""The compiled part; what people use is in the package itself."""

import os
from typing import Any, Literal, final

import numpy as np
import numpy.typing as npt

from ._scene import Document

__version__: str

@final
class Frame:
    """One camera's picture of one step."""

    @property
    def step(self) -> int:
        """The simulation's step number."""
    @property
    def time(self) -> float | None:
        """Physical time, where known."""
    @property
    def camera(self) -> str:
        """Name of the camera."""
    @property
    def array(self) -> npt.NDArray[np.float32]:
        """Scene-linear radiance, premultiplied by coverage, shape (height, width, 4): red, green, blue, coverage."""
    @property
    def rgb(self) -> npt.NDArray[np.uint8]:
        """What a screen shows, shape (height, width, 3), 8-bit sRGB: over the background, exposed, tone-mapped, with overlay."""
    @property
    def png(self) -> bytes:
        """The picture as the bytes of a PNG file."""
    def _repr_png_(self) -> bytes: ...

def png(picture: npt.NDArray[np.uint8]) -> bytes: ...
@final
class Session:
    def __new__(
        cls, scene: Document, range: tuple[float, float] | None, device: str, threads: int, light: bool
    ) -> Session: ...
    @staticmethod
    def wants_range(scene: Document) -> bool: ...
    def advance(
        self,
        array: npt.NDArray[Any],
        step: int,
        time: float | None,
        spacing: list[float],
        origin: list[float],
    ) -> tuple[list[Frame], npt.NDArray[np.float32] | None]: ...

@final
class InSitu:
    def __new__(cls, scene: Document) -> InSitu: ...
    def push(
        self,
        array: npt.NDArray[Any],
        step: int,
        time: float | None,
        spacing: list[float],
        origin: list[float],
        give: bool,
    ) -> Literal["queued", "dropped", "skipped"]: ...
    def flush(self) -> None: ...
    def save_light(self, path: str | os.PathLike[str]) -> None: ...
    def stats(self) -> str: ...
    def close(self) -> None: ...

@final
class Series:
    def __new__(
        cls,
        series: list[str],
        field: str | None,
        component: str | None,
        axes: str | None,
        place: tuple[list[float] | None, list[float] | None, float | None],
        raw: str | None,
        level: int | None,
    ) -> Series: ...
    def info(self) -> str: ...
    def read(self, index: int) -> tuple[npt.NDArray[np.float32], list[float]]: ...
    def read_f64(self, index: int) -> tuple[npt.NDArray[np.float64], list[float]]: ...
