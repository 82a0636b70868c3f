"""Physically lit pictures and movies of time-varying volumes, from NumPy arrays, file series or a running simulation.

A volume is an array with axes (z, y, x), of any integer or float type, in any memory order. Several of them in time are a
series: an array with axes (t, z, y, x), an iterable of volumes, or :func:`open`'s view of files. Each step is lit starting from
the light of the step before.

>>> import numpy as np, gloaming
>>> z, y, x = np.mgrid[-1:1:24j, -1:1:24j, -1:1:24j]
>>> ball = np.exp(-8 * (x**2 + y**2 + z**2))
>>> frame = gloaming.render(ball, size=(64, 48))        # the last line of a notebook cell shows it
>>> frame.array.shape, frame.rgb.dtype.name, frame.png[:4]
((48, 64, 4), 'uint8', b'\\x89PNG')

A *scene* says what to show, lit how, seen from where. It is the scene file of the command line: as a path, as TOML text, or as
nested dictionaries.

>>> scene = {"transfer": {"colormap": "viridis", "opacity": [[0, 0], [1, 0.4]]}, "lights": [{"direction": [1, 0, -1]}]}
>>> moving = [np.roll(ball, n, axis=2) for n in range(3)]
>>> frames = gloaming.render(moving, scene, size=(64, 48), range=(0, 1))
>>> len(frames), frames.array.shape
(3, (3, 48, 64, 4))
"""

from ._frames import Frames
from ._gloaming import Frame, __version__
from ._insitu import InSitu, Stats
from ._rendering import frames, light, render
from ._series import Series, open
from .errors import (
    BugError,
    ClosedError,
    DeviceError,
    FormatError,
    GloamingError,
    IoError,
    LossWarning,
    OutOfMemoryError,
    SceneError,
    UnsupportedError,
)

__all__ = [
    "BugError",
    "ClosedError",
    "DeviceError",
    "FormatError",
    "Frame",
    "Frames",
    "GloamingError",
    "InSitu",
    "IoError",
    "LossWarning",
    "OutOfMemoryError",
    "SceneError",
    "Series",
    "Stats",
    "UnsupportedError",
    "__version__",
    "frames",
    "light",
    "open",
    "render",
]
