"""Record the episodes of this folder again and write manifest.json: python data_small/record.py"""

from __future__ import annotations

import hashlib
import json
import subprocess
import sys
from pathlib import Path

from topokit.io import load_episode

HERE = Path(__file__).parent
EPISODES = {
    f"apron_hook_{seed}.npz": f"topokit simulate --seed {seed} --out data_small/apron_hook_{seed}.npz"
    for seed in range(3)
}
UNITS = {"points": "m", "observed": "m", "actions": "m", "grippers": "m", "centre_line": "m", "dt": "s"}


def describe(name: str, command: str) -> dict[str, object]:
    """One entry of the manifest."""
    episode = load_episode(HERE / name)
    return {
        "file": name,
        "sha256": hashlib.sha256((HERE / name).read_bytes()).hexdigest(),
        "command": command,
        "seed": episode.seed,
        "shape": {"points": episode.points.shape, "observed": episode.observed.shape},
        "dt": episode.dt,
        "units": UNITS,
        "packing": "16-bit integers, one step an array; load with topokit.io.load_episode",
        "made_with": episode.provenance,
    }


def main() -> None:
    """Record every episode in a process of its own, then describe what is there."""
    for command in EPISODES.values():  # one process an episode: only then are the bytes the same every time
        subprocess.run([sys.executable, "-m", *command.split()], cwd=HERE.parent, check=True)
    files = [describe(name, command) for name, command in EPISODES.items()]
    (HERE / "manifest.json").write_text(json.dumps({"files": files}, indent=2) + "\n")


if __name__ == "__main__":
    main()
