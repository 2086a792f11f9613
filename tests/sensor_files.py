"""Files that sensors write, each kind written by the library that others write it with."""

from __future__ import annotations

import dataclasses
import io
from collections.abc import Collection
from pathlib import Path

import numpy as np
import trimesh
from PIL import Image
from pypcd4 import Encoding, PointCloud
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

from topokit.sensors import read_clouds

LENS = {"fx": 30.0, "fy": 30.0, "cx": 20.0, "cy": 15.0}
MESSAGES = get_typestore(Stores.ROS2_HUMBLE)


def ring(t: float = 0.0, n: int = 60) -> np.ndarray:
    """A loop 60 cm across, (n, 3) float32, that moves."""
    angle = np.linspace(0, 2 * np.pi, n, endpoint=False)
    return np.column_stack([0.3 * np.cos(angle), 0.3 * np.sin(angle), 1 + 0.01 * t + 0 * angle]).astype(np.float32)


def clouds(path: Path, **asked: object) -> list[np.ndarray]:
    return [cloud for _, cloud in read_clouds(path, **asked)]


def save_pcd(path: Path, points: np.ndarray, encoding: Encoding = Encoding.BINARY_COMPRESSED) -> Path:
    """With colours, as PCL writes `PointXYZRGB`."""
    colours = PointCloud.encode_rgb(np.full((len(points), 3), 200, np.uint8))
    PointCloud.from_xyzrgb_points(np.column_stack([points, colours.ravel()])).save(path, encoding)
    return path


def depth_image(t: float = 0.0) -> np.ndarray:
    """Millimetres (30, 40) of a ring in front of a wall at 2 m; a corner is not seen."""
    rows, columns = np.indices((30, 40))
    away = np.hypot(rows - 15, columns - 20 - t)
    image = np.where((away > 5) & (away < 9), 1000, 2000).astype(np.uint16)
    image[:3, :3] = 0
    return image


def header(t: float, frame: str = "camera") -> object:
    time = MESSAGES.types["builtin_interfaces/msg/Time"](int(t), round(1e9 * (t % 1)))
    return MESSAGES.types["std_msgs/msg/Header"](time, frame)


def cloud_message(points: np.ndarray, t: float, order: str = "<") -> object:
    """Organised (h, w, 3), with colours between and a gap at the end of each row, as drivers send it."""
    kind = np.dtype(
        {"names": ["x", "y", "z", "rgb"], "formats": [f"{order}f4"] * 4, "offsets": [0, 4, 8, 16], "itemsize": 32}
    )
    height, width = points.shape[:2]
    rows = np.zeros((height, 32 * width + 8), np.uint8)
    for row, part in zip(rows, points, strict=True):
        filled = row[:-8].view(kind)
        for axis, name in enumerate("xyz"):
            filled[name] = part[:, axis]
    field = MESSAGES.types["sensor_msgs/msg/PointField"]
    fields = [field(name, kind.fields[name][1], 7, 1) for name in kind.names]
    message = MESSAGES.types["sensor_msgs/msg/PointCloud2"]
    return message(header(t), height, width, fields, order == ">", 32, rows.shape[1], rows.ravel(), False)


def image_message(image: np.ndarray, t: float, encoding: str = "16UC1") -> object:
    message = MESSAGES.types["sensor_msgs/msg/Image"]
    step = image.strides[0]
    return message(header(t), *image.shape, encoding, 0, step, np.frombuffer(image.tobytes(), np.uint8))


def info_message(t: float, frame: str = "camera", focal: float = 30.0) -> object:
    roi = MESSAGES.types["sensor_msgs/msg/RegionOfInterest"](0, 0, 0, 0, False)
    k = np.array([focal, 0, 20, 0, focal, 15, 0, 0, 1])
    r, p = np.eye(3).ravel(), np.zeros(12)
    message = MESSAGES.types["sensor_msgs/msg/CameraInfo"]
    return message(header(t, frame), 30, 40, "plumb_bob", np.zeros(5), k, r, p, 0, 0, roi)


def save_bag(
    path: Path,
    topics: dict[str, list[object]],
    storage: StoragePlugin = StoragePlugin.MCAP,
    mode: CompressionMode = CompressionMode.NONE,
    empty: Collection[str] = (),
) -> Path:
    """A bag as `ros2 bag record` writes it; message t is received at 100 + t seconds. Topics in `empty` have no message."""
    writer = Writer(path, version=9, storage_plugin=storage)
    if mode != CompressionMode.NONE:
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer as bag:
        for name, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = bag.add_connection(name, kind, typestore=MESSAGES)
            for t, message in enumerate([] if name in empty else messages):
                bag.write(connection, int(1e9 * (100 + t)), MESSAGES.serialize_cdr(message, kind))
    return path


def save_ros1_bag(path: Path, topics: dict[str, list[object]]) -> Path:
    """A bag as `rosbag record -j` writes it."""
    messages1 = get_typestore(Stores.ROS1_NOETIC)
    writer = Writer1(path)
    writer.set_compression(Writer1.CompressionFormat.BZ2)
    with writer as bag:
        for name, messages in topics.items():
            kind = messages[0].__msgtype__
            connection = bag.add_connection(name, kind, typestore=messages1)
            for t, message in enumerate(messages):
                bag.write(connection, int(1e9 * (100 + t)), messages1.serialize_ros1(of_ros1(message), kind))
    return path


def of_ros1(message: object) -> object:
    """The same message as ROS 1 has it: its header has a number, and a camera's matrices are capitals."""
    types = get_typestore(Stores.ROS1_NOETIC).types
    if not hasattr(message, "header"):
        return types[message.__msgtype__](message.data)
    parts = vars(message) | {name.upper(): value for name, value in vars(message).items()}
    parts["header"] = types["std_msgs/msg/Header"](0, message.header.stamp, message.header.frame_id)
    kind = types[message.__msgtype__]
    return kind(**{field.name: parts[field.name] for field in dataclasses.fields(kind)})


def npz(**arrays: object) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def npy(array: object) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def png(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    Image.fromarray(array).save(stream, "png")
    return stream.getvalue()


def pcd(encoding: Encoding = Encoding.BINARY_COMPRESSED) -> bytes:
    stream = io.BytesIO()
    PointCloud.from_xyz_points(ring()).save(stream, encoding)
    return stream.getvalue()


def ply(encoding: str = "binary") -> bytes:
    return trimesh.exchange.ply.export_ply(trimesh.PointCloud(ring()), encoding=encoding)
