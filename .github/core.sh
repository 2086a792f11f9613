#!/usr/bin/env bash
# The wheel as a user gets it, and the core's tests, outside of the checkout, under any Python: .github/core.sh PYTHON [PINS]
# PINS is a file of requirements, for example the lowest versions that pyproject.toml allows (.github/lowest.sh).
set -euo pipefail
cd "$(dirname "$0")/.."
python=$1
pins=${2:+--requirement $2}
"$python" -m venv --clear .venv-core
bin=.venv-core/bin
[ -d "$bin" ] || bin=.venv-core/Scripts
"$bin/python" -m pip install --quiet . $pins gudhi hypothesis pytest scikit-learn
"$bin/pytest" -o addopts= --import-mode=append tests/test_{sampling,rips,rips_properties,cycles,reduction,seqph,linking,mixture,io,core}.py
