"""Write the locks anew from pyproject.toml; versions that still fit stay as they are.

    pip install uv && python .github/lock.py            # keep the versions
    python .github/lock.py --upgrade                     # take the newest

The first part of requirements.txt is the environment of `make test` and `make book`, the second what `make lab` adds.
requirements-torch.txt has torch: its CPU build, and its builds on PyPI with what they need beside the first lock. Every line
has the hashes of its release.
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import tomllib

ROOT = Path(__file__).parent.parent
LOCK = ROOT / "requirements.txt"
TORCH_LOCK = ROOT / "requirements-torch.txt"
HEAD = "# Written by .github/lock.py from pyproject.toml: Python 3.11, all but torch.\n"
LAB = "# make lab\n"
TORCH_HEAD = "# Written by .github/lock.py from pyproject.toml: torch, for Python 3.11.\n"
PYPI = "# its builds on PyPI, and what they need\n"
# The CPU build for Linux on x86-64 is on PyTorch's own index, where uv does not look: its hash by its version.
CPU_BUILD = {"torch==2.13.0": "--hash=sha256:6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b"}


def compiled(known: str, *arguments: str, source: str = "") -> dict[str, str]:
    """Return the pinned entries of what `arguments` name, or of the text `source`, with their hashes, by the pin."""
    command = ["uv", "pip", "compile", *arguments, "--quiet", "--python-version", "3.11"]
    command += ["--generate-hashes", "--no-header", "--no-annotate"]
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "requirements.txt"
        output.write_text(known)
        command += ["--output-file", str(output), *sys.argv[1:]]
        subprocess.run(command, cwd=ROOT, input=source, text=True, check=True)
        entries = output.read_text().replace("\\\n", "").splitlines()
    parts = [entry.split(" --hash=") for entry in entries]
    return {pin.strip(): "".join(f" \\\n    --hash={part.strip()}" for part in hashes) for pin, *hashes in parts}


def of_project(known: str, *groups: str) -> dict[str, str]:
    """Return the entries of the extra `all` and some dependency groups, without torch itself."""
    arguments = ["pyproject.toml", "--extra", "all", "--no-emit-package", "torch", "--no-emit-package", "topokit"]
    for group in ("torch", *groups):
        arguments += ["--group", group]
    return compiled(known, *arguments)


def text_of(entries: dict[str, str]) -> str:
    """Return the lines of entries."""
    return "".join(f"{pin}{hashes}\n" for pin, hashes in entries.items())


def main() -> None:
    """Compile the environment without and with JupyterLab and write the one after the other; then torch."""
    full = of_project(LOCK.read_text(), "lab")
    base = of_project(text_of(full))
    lab = {pin: hashes for pin, hashes in full.items() if pin not in base}
    LOCK.write_text(HEAD + text_of(base) + LAB + text_of(lab))

    # The dependencies of torch's builds on PyPI, which pyproject.toml hides from the first lock.
    (torch,) = tomllib.loads((ROOT / "pyproject.toml").read_text())["dependency-groups"]["torch"]
    known = TORCH_LOCK.read_text() if TORCH_LOCK.exists() else ""
    every = compiled(known, "-", "--no-config", "--universal", source=torch)
    names = {pin.split("==")[0] for pin in base}
    more = {pin: hashes for pin, hashes in every.items() if pin.split("==")[0] not in names}
    TORCH_LOCK.write_text(f"{TORCH_HEAD}{torch}+cpu \\\n    {CPU_BUILD[torch]}\n{PYPI}{text_of(more)}")


if __name__ == "__main__":
    main()
