"""Clouds, and a bag of ROS 2 as the library `rosbags` writes it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

MESSAGES = get_typestore(Stores.ROS2_HUMBLE)


def ring(t: float = 0.0, n: int = 60) -> np.ndarray:
    """A loop 60 cm across, (n, 3) float32, that moves."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), 1 + 0.01 * t + 0 * angle]).astype(np.float32)


def cloud_message(points: np.ndarray, t: float) -> object:
    """Points (n, 3) with a colour each, as drivers send them."""
    rows = np.zeros(len(points), [("x", "f4"), ("y", "f4"), ("z", "f4"), ("", "f4"), ("rgb", "f4"), ("gap", "V12")])
    for axis, name in enumerate("xyz"):
        rows[name] = points[:, axis]
    types = MESSAGES.types
    time = types["builtin_interfaces/msg/Time"](int(t), round(1e9 * (t % 1)))
    header = types["std_msgs/msg/Header"](time, "camera")
    field = types["sensor_msgs/msg/PointField"]
    fields = [field(name, rows.dtype.fields[name][1], 7, 1) for name in ("x", "y", "z", "rgb")]
    data = np.frombuffer(rows.tobytes(), np.uint8)
    message = types["sensor_msgs/msg/PointCloud2"]
    return message(header, 1, len(points), fields, False, rows.itemsize, rows.nbytes, data, False)


def save_bag(path: Path, topics: dict[str, list[object]]) -> Path:
    """A bag as `ros2 bag record` writes it; message t is received at 100 + t seconds."""
    with Writer(path, version=9, storage_plugin=StoragePlugin.MCAP) as bag:
        for name, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = bag.add_connection(name, kind, typestore=MESSAGES)
            for t, message in enumerate(messages):
                bag.write(connection, int(1e9 * (100 + t)), MESSAGES.serialize_cdr(message, kind))
    return path
