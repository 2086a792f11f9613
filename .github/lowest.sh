#!/usr/bin/env bash
# The core's tests with the lowest versions that pyproject.toml allows: .github/lowest.sh PYTHON
set -euo pipefail
cd "$(dirname "$0")/.."
"$1" -m pip install --quiet uv
"$1" -m uv pip compile --quiet --no-header --no-annotate --resolution lowest-direct --python "$1" pyproject.toml --output-file lowest.txt
.github/core.sh "$1" lowest.txt
