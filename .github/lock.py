"""Write requirements.txt, the one lock, anew from pyproject.toml; versions that still fit stay as they are.

    pip install uv && python .github/lock.py            # keep the versions
    python .github/lock.py --upgrade                     # take the newest

The first part is the environment of `make test` and `make book`, the second what `make lab` adds. Every line has the
hashes of its release. torch is not in it: pyproject.toml pins it in the group `torch`, and pip takes the build that fits.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parent.parent
LOCK = ROOT / "requirements.txt"
HEAD = "# Written by .github/lock.py from pyproject.toml: Python 3.11, all but torch.\n"
LAB = "# make lab\n"


def compiled(known: str, *groups: str) -> dict[str, str]:
    """Return the pinned entries of the extra `all` and some dependency groups, with their hashes, by the pin."""
    command = ["uv", "pip", "compile", "pyproject.toml", "--quiet", "--python-version", "3.11", "--extra", "all"]
    command += ["--generate-hashes", "--no-header", "--no-annotate"]
    for package in ("torch", "topokit"):
        command += ["--no-emit-package", package]
    for group in ("torch", *groups):
        command += ["--group", group]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "requirements.txt"
        output.write_text(known)
        subprocess.run([*command, "--output-file", output, *sys.argv[1:]], cwd=ROOT, check=True)
        entries = output.read_text().replace("\\\n", "").splitlines()
    return {entry.split()[0]: " \\\n".join(["", *entry.split()[1:]]).replace("\n", "\n    ") for entry in entries}


def main() -> None:
    """Compile the environment without and with JupyterLab, and write the one after the other."""
    known = LOCK.read_text()
    full = compiled(known, "lab")
    base = compiled("".join(f"{pin}{hashes}\n" for pin, hashes in full.items()))
    lab = {pin: hashes for pin, hashes in full.items() if pin not in base}
    parts = ["".join(f"{pin}{hashes}\n" for pin, hashes in part.items()) for part in (base, lab)]
    LOCK.write_text(HEAD + parts[0] + LAB + parts[1])


if __name__ == "__main__":
    main()
