#!/usr/bin/env bash
# The wheel as a user gets it, and the core's tests, outside of the checkout, under any Python: .github/core.sh PYTHON [PINS]
# They run with numba and, as everything of the core works without it too, once more without.
# PINS is a file of requirements, for example the lowest versions that pyproject.toml allows (.github/lowest.sh).
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
pins=${2:+--requirement $2}
"$python" -m venv --clear .venv-core
bin=.venv-core/bin
[ -d "$bin" ] || bin=.venv-core/Scripts
"$bin/python" -m pip install --quiet . $pins gudhi hypothesis psutil pytest scikit-learn
core=(tests/test_{sampling,compiler,rips,rips_properties,cycles,reduction,seqph,linking,mixture,io,inputs,core}.py)
"$bin/pytest" -o addopts= --import-mode=append "${core[@]}"
"$bin/python" -m pip uninstall --quiet --yes numba llvmlite
"$bin/pytest" -o addopts= --import-mode=append "${core[@]}"
