"""A running simulation's end of gloaming."""

from __future__ import annotations

import json
import os
import warnings
import weakref
from collections.abc import Mapping
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Literal

from . import _gloaming
from ._scene import Scene, document
from ._volume import Triple, triple, volume
from .errors import ClosedError, GloamingError, LossWarning


@dataclass(frozen=True)
class Stats:
    """What has become of the steps: ``pushed = lit + lost + dropped + skipped + waiting``."""

    #: Steps offered.
    pushed: int
    #: Steps lit and written, to every output.
    lit: int
    #: Steps that could not be taken in, lit, or written to some output.
    lost: int
    #: Steps dropped because the queue was full.
    dropped: int
    #: Steps that no trigger asked for, and complete ones when resuming.
    skipped: int
    #: Steps waiting, being lit or being written.
    waiting: int
    #: Bytes copied out of the simulation's memory.
    bytes: int
    #: Time the simulation was held by pushes, in milliseconds.
    held_ms: float
    #: The longest that one push held it.
    longest_held_ms: float
    #: The latest loss or drop: step and reason.
    last_loss: tuple[int, str] | None


def _close(native: _gloaming.InSitu, process: int) -> None:
    if os.getpid() == process:
        native.close()


class InSitu:
    """A session that lights a simulation's steps on threads of its own while the simulation goes on.

    :param scene: What to show, lit how, seen from where, and its ``[insitu]`` table: path, TOML text, or nested dictionaries.
    :param spacing: World length between values along x, y, z, or one number for all.
    :param origin: World position of the first value along x, y, z.
    :param insitu: Keys of the ``[insitu]`` table, over the scene's: ``outputs``, ``ledger``, ``device``, ``threads``, ``queue``,
        ``policy`` (``block``, ``drop-newest``, ``drop-oldest``, ``coalesce``), ``every``, ``every_time``, ``resume``, …

    A simulation does not know its range of values beforehand: give ``field.range`` in the scene, else the range grows as steps
    arrive, and colours shift with it.

    >>> import numpy as np, os, tempfile, gloaming
    >>> out = tempfile.mkdtemp()
    >>> scene = {"field": {"range": [0, 1]}, "render": {"size": [64, 48]}}
    >>> with gloaming.InSitu(scene, outputs=[f"{out}/frame_{{step:03}}.png"], ledger=f"{out}/ledger.csv") as lit:
    ...     for step in range(3):
    ...         density = np.random.default_rng(step).random((18, 18, 18))      # the simulation advances
    ...         _ = lit.push(density[1:-1, 1:-1, 1:-1], step, 0.1 * step)       # without its ghost layers
    >>> sorted(os.listdir(out))
    ['frame_000.png', 'frame_001.png', 'frame_002.png', 'ledger.csv']
    >>> lit.stats.lit
    3
    """

    def __init__(self, scene: Scene = None, *, spacing: Triple = 1.0, origin: Triple = 0.0, **insitu: Any) -> None:
        self._spacing, self._origin = triple(spacing), triple(origin)
        self._pushed = 0
        settings = {f"insitu.{key}": value for key, value in insitu.items()}
        self._native = _gloaming.InSitu(document(scene, **settings))
        # Also at the end of a program that forgot to close: a movie wants its last bytes.
        self._finalizer = weakref.finalize(self, _close, self._native, os.getpid())

    def push(
        self,
        array: Any,
        step: int | None = None,
        time: float | None = None,
        *,
        give: bool = False,
    ) -> Literal["queued", "dropped", "skipped"]:
        """Hands over one step (z, y, x); returns as soon as its values have been copied.

        Views, of any type and memory order, are taken as they are: slice ghost layers off. Other threads run meanwhile. Waits for
        room in the queue when the policy is ``block``.

        :param step: The simulation's step number; counted from 0 where it has none.
        :param time: Its physical time.
        :param give: Takes the array without copying it; nobody may write to it any more.
        :returns: ``queued``, or ``dropped`` by the policy, or ``skipped`` by a trigger.
        :raises UnsupportedError: The array cannot be shown: its type, its number of axes, an axis without values.
        :raises ClosedError: The session was closed.
        """
        step = self._pushed if step is None else int(step)
        taken = self._native.push(volume(array), step, time, self._spacing, self._origin, give)
        self._pushed = step + 1
        return taken

    def flush(self) -> None:
        """Waits until every step pushed so far is lit and written."""
        self._native.flush()

    def save_light(self, path: str | os.PathLike[str]) -> None:
        """Waits until every step pushed so far is lit and written, and keeps their light in a file.

        Call it where the simulation writes a restart file. A run that is restarted from there goes on warm with
        ``light_state=path``, with the frames that this one makes. The file appears under its name only when it is whole.

        :raises UnsupportedError: No step is lit yet, or the model is ``paper``.
        :raises ClosedError: The session was closed.
        """
        self._native.save_light(path)

    @property
    def stats(self) -> Stats:
        """What has become of the steps so far."""
        stats: Mapping[str, Any] = json.loads(self._native.stats())
        loss = stats["last_loss"]
        return Stats(**{**stats, "last_loss": loss and (loss[0], loss[1])})

    @property
    def closed(self) -> bool:
        """True after :meth:`close`."""
        return not self._finalizer.alive

    def close(self) -> Stats:
        """Lights what is still waiting, closes every file and ends the threads. Steps that were lost or dropped are a
        :class:`LossWarning`; a file that could not be closed is an error."""
        if self._finalizer.detach():
            self._native.close()
            stats = self.stats
            if stats.last_loss:
                step, why = stats.last_loss
                text = f"{stats.lost} of {stats.pushed} steps lost, {stats.dropped} dropped; the last, step {step}: {why}"
                warnings.warn(text, LossWarning, stacklevel=2)
        return self.stats

    def __enter__(self) -> InSitu:
        if self.closed:
            raise ClosedError("a session is opened once: make another")
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self.close()
        except GloamingError:
            # What ended the simulation matters more.
            if error is None:
                raise

    def __repr__(self) -> str:
        stats = self.stats
        return f"<gloaming.InSitu: {stats.lit} of {stats.pushed} steps lit{', closed' if self.closed else ''}>"
