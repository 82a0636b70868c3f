"""Several frames, shown together."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import overload

import numpy as np
import numpy.typing as npt

from ._gloaming import Frame, png


class Frames(Sequence[Frame]):
    """Frames in order: steps, and the cameras of each. A notebook shows a sheet of them.

    >>> import numpy as np, gloaming
    >>> frames = gloaming.render(np.random.default_rng(0).random((2, 8, 8, 8)), size=(32, 24))
    >>> frames[1].step, frames.array.shape, frames[:1]
    (1, (2, 24, 32, 4), <gloaming.Frames: 1>)
    """

    #: Pictures on the sheet, at most, and its width in pixels.
    SHOWN, WIDTH = 12, 1200

    def __init__(self, frames: Iterable[Frame]) -> None:
        self._frames = list(frames)

    def __len__(self) -> int:
        return len(self._frames)

    @overload
    def __getitem__(self, index: int) -> Frame: ...
    @overload
    def __getitem__(self, index: slice) -> Frames: ...
    def __getitem__(self, index: int | slice) -> Frame | Frames:
        return Frames(self._frames[index]) if isinstance(index, slice) else self._frames[index]

    @property
    def array(self) -> npt.NDArray[np.float32]:
        """Scene-linear radiance and coverage of all, shape (frames, height, width, 4)."""
        return np.stack([frame.array for frame in self])

    @property
    def rgb(self) -> npt.NDArray[np.uint8]:
        """What a screen shows of all, shape (frames, height, width, 3), 8-bit sRGB."""
        return np.stack([frame.rgb for frame in self])

    @property
    def png(self) -> bytes:
        """A sheet of at most :attr:`SHOWN` of the frames, evenly chosen, as the bytes of a PNG file."""
        if not self:
            return png(np.zeros((1, 1, 3), np.uint8))
        chosen = np.unique(np.linspace(0, len(self) - 1, min(len(self), self.SHOWN)).round().astype(int))
        columns = int(np.ceil(np.sqrt(len(chosen))))
        height, width, _ = self[0].rgb.shape
        # Every n-th pixel: a glance, not a picture to keep.
        thin = max(1, -(-columns * width // self.WIDTH))
        h, w = -(-height // thin), -(-width // thin)
        sheet = np.zeros((-(-len(chosen) // columns) * h, columns * w, 3), np.uint8)
        for n, index in enumerate(chosen):
            top, left = n // columns * h, n % columns * w
            sheet[top : top + h, left : left + w] = self[index].rgb[::thin, ::thin]
        return png(sheet)

    def _repr_png_(self) -> bytes | None:
        return self.png if self else None

    def __repr__(self) -> str:
        return f"<gloaming.Frames: {len(self)}>"
