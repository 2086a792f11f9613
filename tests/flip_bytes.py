"""Flip every byte of small files in turn: each flip is noticed (an error of ours) or harmless (the same answer).

    python tests/flip_bytes.py                      all: a dataset with labels, an episode, states, a checkpoint
    python tests/flip_bytes.py dataset --share 0.1  a seeded tenth of its bytes

A byte is flipped in one bit, drawn by its place, and back again. What each file gave is printed, and exit code 1 when another
answer or an error of another kind came out of any.
"""

from __future__ import annotations

import argparse
import hashlib
import pickle
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from topokit import track
from topokit.data import Dataset, generate_dataset, label_dataset
from topokit.io import load_episode, load_states, save_episode, save_states
from topokit.models import Normalisation, Predictor, Shape, build

from conftest import DATA, polygon
from small_datasets import SEED, TINY, without_dask

Reader = Callable[[Path], str]


def digest(*parts: Any) -> str:
    """One checksum of anything that pickles, arrays by their values."""
    return hashlib.sha256(pickle.dumps([plain(part) for part in parts])).hexdigest()


def plain(part: Any) -> Any:
    if hasattr(part, "detach"):
        part = part.detach().cpu().numpy()
    if isinstance(part, np.ndarray):
        return (str(part.dtype), part.shape, part.tobytes())
    if isinstance(part, dict):
        return [(plain(key), plain(value)) for key, value in sorted(part.items())]
    if isinstance(part, (list, tuple)):
        return [plain(value) for value in part]
    if hasattr(part, "__dataclass_fields__"):
        return [(name, plain(getattr(part, name))) for name in part.__dataclass_fields__ if name != "_curve"]
    return repr(part)


def answer_of(folder: Path) -> str:
    """Everything that a dataset says."""
    dataset = Dataset(folder)
    answers = [dataset.seed, dataset.config, dataset.records, dataset.garments, len(dataset.group.numbers)]
    answers += [dataset.checksum(), dataset.group.names("labels"), dataset.split("episode"), list(dataset)]
    answers += [dataset.document(number) for number in dataset.episodes.tolist()]
    for name in dataset.group.names("labels"):
        answers += [dataset.labels(name).manifest, dataset.labelled(name), dataset.labels(name).checksum()]
        answers += [dataset.states(number, name) for number in dataset.labelled(name).tolist()]
    return digest(*answers)


def notice(folder: Path, path: Path, place: int, bits: int, read: Reader, whole: str) -> bool:
    """Flip bits of a byte, read, and flip them back: whether it was noticed. AssertionError when the answer is another."""
    raw = path.read_bytes()
    path.write_bytes(raw[:place] + bytes([raw[place] ^ bits]) + raw[place + 1 :])
    try:
        again = read(folder)
    except (ValueError, OSError, KeyError):  # FormatError, and what says that something is not there
        return True
    finally:
        path.write_bytes(raw)
    assert again == whole, f"byte {place} of {path.name}, bits {bits:08b}: another answer"
    return False


def outcome(root: Path, path: Path, place: int, read: Reader, whole: str) -> str:
    """What one flip did; what is wrong is told."""
    try:
        return "noticed" if notice(root, path, place, 1 << (place % 8), read, whole) else "harmless"
    except Exception as error:  # another answer, or an error that is none of ours
        print(f"{path.relative_to(root.parent)}, byte {place}: {type(error).__name__}: {error}", file=sys.stderr)
        return "wrong"


def dataset(folder: Path) -> tuple[Path, Reader]:
    with without_dask():
        short = replace(TINY, tasks={"mask-hook": 1}, sizes={}, simulation=replace(TINY.simulation, frames=4))
        generate_dataset(short, folder / "data", 1, SEED, progress=False)
        label_dataset(folder / "data", options={"alpha": 0.003}, progress=False)
    return folder / "data", answer_of


def episode(folder: Path) -> tuple[Path, Reader]:
    long = load_episode(DATA / "apron_hook_0.npz")
    parts = {name: getattr(long, name)[:3] for name in ("points", "observed", "actions", "grippers", "held")}
    return save_episode(folder / "episode.npz", replace(long, **parts)), lambda path: digest(load_episode(path))


def states(folder: Path) -> tuple[Path, Reader]:
    tracked = track([polygon(20), polygon(21), polygon(20) * 1.01], alpha=0.1)
    return save_states(folder / "states.npz", tracked), lambda path: digest(load_states(path))


def checkpoint(folder: Path) -> tuple[Path, Reader]:
    def read(path: Path) -> str:
        predictor = Predictor.load(path)
        return digest(predictor.description, predictor.model.state_dict())

    shape, normalisation, options = Shape(2, 2, 4, 1), Normalisation(), {"hidden": (2, 2)}
    path = folder / "tiny.safetensors"
    Predictor(build("mlp", shape, normalisation, options)).save(path)
    return path, read


KINDS = {kind.__name__: kind for kind in (dataset, episode, states, checkpoint)}


def places(root: Path, share: float) -> Iterator[tuple[Path, int]]:
    """Every byte, or a seeded share of them."""
    rng = np.random.default_rng(0)
    for path in sorted(root.rglob("*")) if root.is_dir() else [root]:
        if path.is_file() and path.name != "timing.jsonl":  # a log, which nobody reads
            yield from ((path, int(place)) for place in np.flatnonzero(rng.random(path.stat().st_size) < share))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("kinds", nargs="*", default=[], metavar="KIND", help=", ".join(KINDS))
    parser.add_argument("--share", type=float, default=1.0, help="of the bytes (default: all)")
    options = parser.parse_args()
    wrong = 0
    for name in options.kinds or KINDS:
        with tempfile.TemporaryDirectory() as temporary:
            root, read = KINDS[name](Path(temporary))
            whole, counts = read(root), Counter[str]()
            for path, place in places(root, options.share):
                counts[outcome(root, path, place, read, whole)] += 1
            wrong += counts["wrong"]
            print(f"{name}: {sum(counts.values())} bytes flipped, {dict(sorted(counts.items()))}", flush=True)
    return int(wrong > 0)


if __name__ == "__main__":
    sys.exit(main())
