#!/usr/bin/env bash
# Licences and a bill of materials of the environment, into _build, and an audit for known vulnerabilities.
set -euo pipefail
cd "$(dirname "$0")/.."
make env
python=.venv/bin/python
tools=$("$python" -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["tools"])')
"$python" -m venv --clear .venv-tools
.venv-tools/bin/python -m pip install --quiet $tools
mkdir -p _build
.venv-tools/bin/pip-licenses --python="$python" --from=mixed --order=license --output-file=_build/licences.txt
.venv-tools/bin/cyclonedx-py environment "$python" --pyproject pyproject.toml --output-reproducible --output-file _build/bom.json
sed '1,/^# its builds on PyPI/d' requirements-torch.txt >_build/torch.txt
.venv-tools/bin/pip-audit --strict --no-deps --disable-pip --requirement requirements.txt --requirement _build/torch.txt
