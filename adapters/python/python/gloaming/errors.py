"""Exceptions, one for each party who can act on it; every one is a :class:`GloamingError`."""

from __future__ import annotations

import os
from pathlib import Path


class GloamingError(Exception):
    """What went wrong, with the file, dataset, key or step concerned and the next thing to try."""

    def __init__(self, message: str, **fields: object) -> None:
        super().__init__(message)
        for name, value in fields.items():
            setattr(self, name, value)

    def __str__(self) -> str:
        return str(self.args[0])


class IoError(GloamingError, OSError):
    """The operating system refused: a path, a permission, a full disk."""

    errno: int | None
    #: The file or directory concerned.
    path: Path

    @property
    def filename(self) -> str:
        """The same as text, as an :class:`OSError` has it."""
        return os.fspath(self.path)


class FormatError(GloamingError, ValueError):
    """A file, or what a program handed over, is not what it should be, or needs a setting to be read."""

    #: The file, and ``:/dataset`` where there is one.
    path: Path
    #: What was found.
    found: str
    #: The setting or command that would help; may be empty.
    remedy: str


class SceneError(GloamingError, ValueError):
    """The scene says something impossible.

    >>> import gloaming
    >>> try:
    ...     gloaming.render([[[0.0]]], {"light": {"directons": 8}})
    ... except gloaming.SceneError as e:
    ...     print(e.key)
    light.directons
    """

    #: Dotted key, such as ``light.tolerance``.
    key: str
    #: Line in the scene file, counted from 1, where there is one.
    line: int | None
    #: What is wrong and which values are allowed.
    reason: str


class UnsupportedError(GloamingError, NotImplementedError):
    """A combination of settings, or a kind of array, that this version does not do."""


class OutOfMemoryError(GloamingError, MemoryError):
    """The working set does not fit."""

    #: Bytes that the step needs.
    needed: int
    #: Bytes that were allowed.
    budget: int


class DeviceError(GloamingError, RuntimeError):
    """The compute device failed or does not exist."""


class ClosedError(GloamingError, RuntimeError):
    """The session was closed or interrupted."""


class BugError(GloamingError, RuntimeError):
    """A fault of gloaming's own: please report it."""


class LossWarning(RuntimeWarning):
    """Steps were lost or dropped on their way from a simulation."""
