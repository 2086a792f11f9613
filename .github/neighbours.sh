#!/usr/bin/env bash
# The recipes of "Coming from ..." with the packages that the environment lacks, in an environment beside it.
set -euo pipefail
cd "$(dirname "$0")/.."
make env
python=.venv/bin/python
packages=$("$python" -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["neighbours"])')
"$python" -m venv --clear .venv-neighbours
"$python" -c "import site; print(site.getsitepackages()[0])" >.venv-neighbours/lib/python3.11/site-packages/beside.pth
.venv-neighbours/bin/python -m pip install --quiet $packages
.venv-neighbours/bin/python -m pytest -o addopts=-ra tests/test_coming_from.py tests/test_tracking.py
