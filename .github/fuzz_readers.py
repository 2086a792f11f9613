"""Coverage-guided fuzz of everything that reads a file or a stream of a stranger, by Atheris.

    pip install atheris                                   # CPython on Linux
    python .github/fuzz_readers.py ply --runs 200000        # one of READERS
    python .github/fuzz_readers.py states crash-1234        # again what was found

An input may be refused by a `ValueError` (a `FormatError` is one) or an `OSError`, whose words fit on a screen. Anything else
stops the run and leaves the input in a file: another exception, which would be a traceback from somewhere inside; ten seconds
for one input; more memory than `ROOM`. Checksums keep mutated bytes out of what stands behind them; so archives and records
are taken apart, changed part by part, and sealed anew, as a stranger would.
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import io
import json
import os
import resource
import sys
import tempfile
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any
from unittest import mock

import atheris
import numpy as np

KERNELS = ("_cloud", "_pairs", "_cycles", "kernel")
SPARED = [*(f"topokit.rips.{name}" for name in KERNELS), "topokit.sim._pattern"]  # Atheris keeps what arrays compare to
sys.path.append(str(Path(__file__).parent.parent / "tests"))
with atheris.instrument_imports(include=["topokit"], exclude=SPARED):
    import sensor_files as files
    from pypcd4 import Encoding
    from rosbags.rosbag2 import StoragePlugin

    from topokit import SeqPH, track
    from topokit import io as episodes
    from topokit._archive import load_archive
    from topokit._config import load
    from topokit.sensors import Pipeline, read_clouds, read_stream
    from topokit.sim import SimulationConfig

LONGEST = 1 << 15  # bytes of an input
ROOM = 800 << 20  # bytes of address space beside what the libraries have taken
CLOUDS = ("npy", "npz", "png", "pcd", "mcap", "db3", "bag")
DATA = Path(__file__).parent.parent / "data_small"
TYPES = ("u1", "i4", "i8", "u2", "f4", "f8", "?", "U3", "c16", "M8[s]")


def cloud(suffix: str) -> Callable[[bytes], object]:
    """A reader of files of clouds."""
    path = FOLDER / f"cloud.{suffix}"

    def read(data: bytes) -> None:
        path.write_bytes(data)
        for _, points in read_clouds(path, intrinsics=files.LENS, unit="m"):
            len(points)

    return read


def configuration() -> Callable[[bytes], object]:
    """A reader of configurations: of mutated bytes, or of a whole one of which parts were changed."""
    with atheris.instrument_imports(include=["topokit"], exclude=SPARED):
        from topokit.data import DatasetConfig
        from topokit.models import TrainConfig

    path = FOLDER / "configuration.json"
    kinds = {SimulationConfig: {}, DatasetConfig: DatasetConfig().to_json(), Pipeline: {"crop": [[0, 0, 0], [1, 1, 1]]}}
    kinds[TrainConfig] = {"model": "mlp", "split": {"seed": 1}, "windows": {"labels": "full"}, "shape": {"points": 9}}

    def read(data: bytes) -> None:
        choose = atheris.FuzzedDataProvider(data)
        kind = list(kinds)[choose.ConsumeIntInRange(0, len(kinds) - 1)]
        content = choose.ConsumeBytes(LONGEST)
        if choose.ConsumeBool():
            words = json.loads(json.dumps(kinds[kind]))
            change_words(choose, words)
            content = json.dumps(words).encode()
        path.write_bytes(content)
        load(kind, path)

    return read


def live(data: bytes) -> None:
    """What `topokit track --live` reads; clouds of more than a few points are read, and not tracked."""
    tracker = SeqPH()
    for cloud in read_stream(io.BufferedReader(io.BytesIO(data)), check_unit=False):
        if cloud.size <= 60:
            json.dumps(tracker.update(cloud).as_dict())


def archive(
    kind: str, text: dict[str, Any], arrays: dict[str, np.ndarray], load: Callable[[Path], object]
) -> Callable[[bytes], object]:
    """A reader of archives: of mutated bytes, or of a whole one of which parts were changed."""
    path = FOLDER / f"{kind}.npz"

    def read(data: bytes) -> object:
        if data[:2] == b"PK":
            path.write_bytes(data)
        else:
            choose = atheris.FuzzedDataProvider(data)
            words, parts = dict(text), dict(arrays)
            for _ in range(choose.ConsumeIntInRange(1, 4)):
                if choose.ConsumeBool():
                    change_array(choose, parts)
                else:
                    change_words(choose, words)
            with mock.patch.object(episodes, "load_archive", return_value=(words, parts)):  # as if sealed anew
                return load(path)
        return load(path)

    return read


def change_array(choose: atheris.FuzzedDataProvider, parts: dict[str, np.ndarray]) -> None:
    """Take an array out, or change its type, its shape or a value."""
    name = choose.PickValueInList(sorted(parts) or ["points"])
    way, old = choose.ConsumeIntInRange(0, 4), parts.get(name, np.zeros(2))
    if way == 0:
        parts.pop(name, None)
    elif way == 1:
        shape = tuple(choose.ConsumeIntInRange(0, 5) for _ in range(choose.ConsumeIntInRange(0, 4)))
        kind = np.dtype(choose.PickValueInList(list(TYPES)))
        content = choose.ConsumeBytes(int(np.prod(shape)) * kind.itemsize)
        content = content.ljust(int(np.prod(shape)) * kind.itemsize, b"\0")
        if kind.kind == "U":
            content = bytes(len(content))
        parts[name] = np.frombuffer(content, kind).reshape(shape)
    elif way == 2 and old.ndim:
        parts[name] = np.moveaxis(old[: choose.ConsumeIntInRange(0, 3)], 0, -1)
    elif old.size and old.dtype.kind in "iuf":
        parts[name] = old = old.copy()
        value = choose.PickValueInList([-1, 0, 1, 2, 2**31 - 1, 2**63 - 1, float("nan"), float("inf"), 1e300, 5e-324])
        with (
            np.errstate(all="ignore"),
            warnings.catch_warnings(action="ignore"),
            contextlib.suppress(OverflowError, ValueError),
        ):
            old.reshape(-1)[choose.ConsumeIntInRange(0, old.size - 1)] = value


def value(choose: atheris.FuzzedDataProvider, depth: int = 0) -> Any:
    """Something that JSON can hold."""
    kind = choose.ConsumeIntInRange(0, 8 if depth < 3 else 5)
    if kind == 6:
        return [value(choose, depth + 1) for _ in range(choose.ConsumeIntInRange(0, 3))]
    if kind == 7:
        return {word(choose): value(choose, depth + 1) for _ in range(choose.ConsumeIntInRange(0, 3))}
    plain = [None, True, choose.ConsumeInt(4), choose.ConsumeFloat(), word(choose), 10**30]
    return plain[kind] if kind < 6 else [[]]


def word(choose: atheris.FuzzedDataProvider) -> str:
    """A string; JSON holds no lone surrogates."""
    return choose.ConsumeUnicodeNoSurrogates(choose.ConsumeIntInRange(0, 6))


def change_words(choose: atheris.FuzzedDataProvider, words: Any) -> None:
    """Take an entry out of a document, or put another in its place, here or deeper."""
    keys = list(range(len(words))) if isinstance(words, list) else sorted(words)
    if not keys:
        return
    key = choose.PickValueInList(keys)
    if isinstance(words[key], (dict, list)) and choose.ConsumeIntInRange(0, 3):
        words[key] = words[key].copy()
        change_words(choose, words[key])
    elif choose.ConsumeIntInRange(0, 3):
        words[key] = value(choose)
    else:
        del words[key]


def episode() -> Callable[[bytes], object]:
    """Return a reader of episodes, whose template has three frames of forty points."""
    whole = episodes.load_episode(DATA / "apron_hook_0.npz")
    arrays: dict[str, Any] = {name: getattr(whole, name)[:3] for name in ("actions", "grippers", "held")}
    for name in ("points", "observed"):
        arrays[name] = getattr(whole, name)[:3, :40]
    arrays["faces"] = whole.faces[(whole.faces < 40).all(axis=1)]
    arrays["loops"] = (np.arange(4, dtype=np.int32), np.arange(4, 9, dtype=np.int32))
    small = dataclasses.replace(whole, **arrays, observation={}, physics={}, provenance={})
    path = episodes.save_episode(FOLDER / "template_episode.npz", small)
    return archive("topokit-episode", *load_archive(path, "topokit-episode"), episodes.load_episode)


def states() -> Callable[[bytes], object]:
    angle = np.arange(20) * np.pi / 10
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    path = episodes.save_states(FOLDER / "template.npz", track([ring, np.zeros((1, 3)), ring * 1.01], alpha=0.1))

    def load(path: Path) -> None:
        for state in episodes.load_states(path):
            for loop in state.loops:
                json.dumps([loop.centre.tolist(), loop.quadrilateral.tolist()])
                with contextlib.suppress(LookupError):  # files of the first schema know no cycles
                    json.dumps(loop.cycle_points.tolist())

    return archive("topokit-states", *load_archive(path, "topokit-states"), load)


def checkpoint() -> Callable[[bytes], object]:
    """A checkpoint of which the description was changed, or its header's bytes."""
    from topokit.models import Predictor

    whole, path = (
        min((DATA / "checkpoints").glob("**/*.safetensors"), key=os.path.getsize).read_bytes(),
        FOLDER / "m.safetensors",
    )
    path.write_bytes(whole)
    Predictor.load(path)  # the first takes seconds
    size = int.from_bytes(whole[:8], "little")
    header, body = json.loads(whole[8 : 8 + size]), whole[8 + size :]

    def read(data: bytes) -> None:
        choose = atheris.FuzzedDataProvider(data)
        if choose.ConsumeBool():
            path.write_bytes(choose.ConsumeBytes(LONGEST))
        else:
            changed = json.loads(json.dumps(header))
            document = json.loads(changed["__metadata__"]["topokit"])
            if choose.ConsumeIntInRange(0, 3):
                change_words(choose, document)
                changed["__metadata__"]["topokit"] = json.dumps(document)
            else:
                change_words(choose, changed)
            content = json.dumps(changed).encode()
            path.write_bytes(len(content).to_bytes(8, "little") + content + body)
        Predictor.load(path)

    return read


def dataset() -> Callable[[bytes], object]:
    """Return a reader of a dataset of one episode with labels, one document of which was changed."""
    from topokit.data import Dataset, WindowDataset, check_dataset

    folder = FOLDER / "dataset"
    source = DATA / "dataset"
    (folder / "labels" / "full").mkdir(parents=True)
    documents = ("dataset.json", "labels/full/labels.json")
    for name in (*documents, "00000000.npz", "labels/full/00000000.npz"):
        (folder / name).write_bytes((source / name).read_bytes())
    whole = {name: (folder / name).read_bytes() for name in documents}
    check_dataset(folder)  # the first takes seconds

    def read(data: bytes) -> None:
        choose = atheris.FuzzedDataProvider(data)
        name = choose.PickValueInList(list(documents))
        if choose.ConsumeIntInRange(0, 3):
            document = json.loads(whole[name])
            change_words(choose, document)
            content = json.dumps(document).encode()
        else:
            content = choose.ConsumeBytes(LONGEST)
        (folder / name).write_bytes(content)
        try:
            opened = Dataset(folder)
            opened.checksum(), len(opened.records), repr(opened)
            with contextlib.suppress(KeyError):  # a mapping's own word for what is not there
                opened[0], opened.states(0, "full"), WindowDataset(opened, [0])[0]
            if data[:1] == b"\7":  # it takes seconds
                check_dataset(folder)
        finally:
            (folder / name).write_bytes(whole[name])

    return read


READERS: dict[str, Callable[[], Callable[[bytes], object]]] = {
    **{suffix: lambda suffix=suffix: cloud(suffix) for suffix in CLOUDS},
    "cloud.ply": lambda: cloud("ply"),
    "configuration": configuration,
    "live": lambda: live,
    "episode": episode,
    "states": states,
    "checkpoint": checkpoint,
    "dataset": dataset,
}


def npy(array: np.ndarray) -> bytes:
    stream = io.BytesIO()
    np.save(stream, array)
    return stream.getvalue()


def seeds(reader: str) -> list[bytes]:
    """Whole inputs to begin with."""
    if reader in (*CLOUDS, "cloud.ply"):
        return seeds_of_clouds(reader)
    return {
        "episode": [(DATA / "apron_hook_0.npz").read_bytes()[:LONGEST], bytes(range(40)), b"\1" * 40],
        "live": [npy(np.eye(4)) + npy(np.eye(4) * 2), npy(np.zeros((3, 2), "i1"))],
    }.get(reader, [bytes(range(40)), b"\1" * 40])


def seeds_of_clouds(reader: str) -> list[bytes]:
    """Whole files of clouds, as the libraries of each kind write them."""
    messages = {"/points": [files.cloud_message(files.ring().reshape(6, 10, 3), 1)]}
    storage = {"mcap": StoragePlugin.MCAP, "db3": StoragePlugin.SQLITE3}
    if reader in storage:
        bag = files.save_bag(FOLDER / "bag", messages, storage[reader])
        return [path.read_bytes() for path in bag.glob(f"*.{reader}")]
    if reader == "bag":
        return [files.save_ros1_bag(FOLDER / "seed.bag", messages).read_bytes()]
    return {
        "npy": [files.npy(files.ring()), files.npy(files.depth_image())],
        "npz": [files.npz(points=[files.ring()], times=[0.5]), files.npz(arr_0=files.ring(), arr_1=files.ring())],
        "png": [files.png(files.depth_image())],
        "pcd": [files.pcd(encoding) for encoding in (Encoding.ASCII, Encoding.BINARY, Encoding.BINARY_COMPRESSED)],
        "cloud.ply": [files.ply("ascii"), files.ply(), *seeds("ply")],
    }[reader]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("reader", choices=READERS)
    parser.add_argument("again", nargs="*", help="inputs that were found, to be read again")
    parser.add_argument("--runs", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=1, help="of the changes")
    parser.add_argument("--seconds", type=int, default=0, help="end after so many; 0 for no end")
    options = parser.parse_args()
    track([np.eye(4)])  # kernels are compiled, or read, before an input is timed
    read = READERS[options.reader]()
    warnings.simplefilter("error")  # NumPy's of overflow: then a number was not checked
    logging_off()
    counts = {"read": 0, "refused": 0}

    def one(data: bytes) -> None:
        try:
            read(data)
            counts["read"] += 1
        except (ValueError, OSError) as error:
            counts["refused"] += 1
            if not 0 < len(str(error)) < 2000:
                raise AssertionError("the message is empty, or fills the screen") from error

    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + ROOM, -1))
    corpus = FOLDER / "corpus"
    corpus.mkdir()
    for number, seed in enumerate(seeds(options.reader)):
        (corpus / str(number)).write_bytes(seed)
    flags = [
        f"-runs={options.runs}",
        f"-max_len={LONGEST}",
        "-timeout=10",
        "-rss_limit_mb=0",
        "-print_final_stats=1",
        f"-seed={options.seed}",
        f"-max_total_time={options.seconds}",
    ]
    atheris.Setup([sys.argv[0], *flags, *(options.again or [str(corpus)])], one)
    import atexit

    atexit.register(lambda: print(f"{options.reader}: {counts}", flush=True))
    atheris.Fuzz()


def logging_off() -> None:
    """Show no warnings of the readers."""
    import logging

    logging.disable(logging.CRITICAL)


if __name__ == "__main__":
    with tempfile.TemporaryDirectory(dir="/dev/shm" if os.path.isdir("/dev/shm") else None) as name:
        FOLDER = Path(name)
        main()
