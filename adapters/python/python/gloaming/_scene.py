"""Scenes as the compiled part takes them: text, its name in messages, and overrides."""

from __future__ import annotations

import json
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Union

from .errors import IoError

#: A scene file's path, a scene as TOML text (several lines, or none), or as nested dictionaries.
Scene = Union[None, str, "os.PathLike[str]", Mapping[str, Any]]

#: Text, name, overrides.
Document = tuple[str, str, list[str]]


def document(scene: Scene, **settings: Any) -> Document:
    """A scene with settings over it; a setting's name is a dotted key, and ``None`` leaves it alone."""
    sets = [f"{key}={_value(value)}" for key, value in settings.items() if value is not None]
    if scene is None:
        return "", "scene", sets
    if isinstance(scene, Mapping):
        text, own = _overrides(scene)
        return text, "scene", own + sets
    text = os.fspath(scene)
    if isinstance(scene, str) and ("\n" in text or "=" in text and not text.endswith(".toml")):
        return text, "scene", sets
    try:
        return Path(text).read_text(encoding="utf-8"), text, sets
    except OSError as e:
        raise IoError(f"{text}: {e.strerror}", path=Path(text), errno=e.errno) from None


def _overrides(scene: Mapping[str, Any]) -> tuple[str, list[str]]:
    """Nested dictionaries as overrides, which have no lines that an error could name, and the text that makes room for them."""
    room, sets = [], []
    for table, keys in scene.items():
        if isinstance(keys, Mapping):
            entries = {table: keys}
        elif "." in table:
            sets.append(f"{table}={_value(keys)}")
            continue
        else:
            entries = {f"{table}.{n}": entry for n, entry in enumerate(keys)}
            room += [f"[[{table}]]"] * len(entries)
        for place, entry in entries.items():
            sets += [f"{place}.{key}={_value(value)}" for key, value in entry.items() if value is not None]
    return "\n".join(room), sets


def _value(value: Any) -> str:
    # Numbers, strings, booleans and lists are written in TOML as in JSON.
    return json.dumps(value, ensure_ascii=False, default=_plain)


def _plain(value: Any) -> Any:
    if hasattr(value, "tolist"):
        return value.tolist()
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{value!r} has no place in a scene: write numbers, strings, booleans or lists")
