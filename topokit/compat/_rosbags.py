"""Tracked loops as a bag of ROS 2."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
from rosbags.rosbag2 import Writer
from rosbags.typesys import Stores, get_typestore

from topokit._archive import new_folder
from topokit.state import TopologicalState

from ._ros import TYPES, LoopMessages

_STORE = get_typestore(Stores.ROS2_HUMBLE)


def empty(kind: str) -> Any:
    """A message as rclpy makes one: numbers are 0, texts and lists empty."""
    return _STORE.types[kind](**{name: _blank(node.name, of) for name, (node, of) in _STORE.fielddefs[kind][1]})


def _blank(node: str, of: Any) -> Any:
    if node == "NAME":
        return empty(of)
    return np.empty(0, np.uint8) if node != "BASE" else "" if of[0] == "string" else 0


def save_markers(
    path: str | Path, states: Iterable[TopologicalState], *, frame_id: str = "map", topic: str = "/loops"
) -> Path:
    """Write tracked states as a bag of ROS 2 (Humble and later), to be played beside that of the clouds.

    Parameters
    ----------
    path : path
        A new folder.
    states : iterable of TopologicalState
        Of loops in space.
    frame_id : str
        Of the clouds, as their headers have it.
    topic : str
        Of the markers; beside it is `topic`/json.

    Raises
    ------
    FileExistsError, ValueError
        When there is such a folder; when loops are not in space.
    """
    answer = LoopMessages(new=empty)
    with new_folder(path) as folder, Writer(folder, version=8) as bag:
        names = dict(zip((topic, f"{topic}/json"), TYPES.values(), strict=True))
        outs = [bag.add_connection(name, kind, typestore=_STORE) for name, kind in names.items()]
        for state in states:
            header, when = empty("std_msgs/msg/Header"), round(1e9 * state.time)
            header.frame_id, (header.stamp.sec, header.stamp.nanosec) = frame_id, divmod(when, 10**9)
            for out, told in zip(outs, answer.of(state, header), strict=True):
                bag.write(out, when, _STORE.serialize_cdr(told, out.msgtype))
    return Path(path)
