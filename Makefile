# make book        build the environment if needed, run every chapter on data_small, build the book in _build/html
# make lab         open JupyterLab on the first of the chapters' copies in plain Markdown (runs/lab)
# make test        unit tests, doctests, every chapter, lint; in the same environment
# make check-book  open every page of the built book in Chromium, without a network, and use every control of its figures
# make pdf         print the whole book by Chromium
# make clean       remove what the others made

IS_311 := -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'
PYTHON ?= $(shell for p in python3.11 python3 python; do $$p $(IS_311) 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
export PYTHONHASHSEED = 0
export PIP_DISABLE_PIP_VERSION_CHECK = 1
# The packages of a dependency group of pyproject.toml.
group = $(shell $(or $(PYTHON),false) -c 'import tomllib; print(*tomllib.load(open("pyproject.toml", "rb"))["dependency-groups"]["$(1)"])')

define need_311
@$(or $(PYTHON),false) $(IS_311) 2>/dev/null || { echo "topokit: needs Python 3.11$(if $(PYTHON), and '$(PYTHON)' is not that):\
 install it, or name it (make PYTHON=/path/to/python3.11 ...), or for other versions: conda env create -f environment.yml" >&2; exit 1; }
endef

.PHONY: help book pdf check-book test lint lab env clean
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# make/make/p' Makefile

# The environment is rebuilt when the locks or the package's own metadata change. torch has a lock of its own: its CPU build where
# pip finds one, else the build of PyPI.
PIP_LOCKED = $(BIN)/python -m pip install --quiet --require-hashes --no-deps
env: $(VENV)/ready
$(VENV)/ready: requirements.txt requirements-torch.txt pyproject.toml
	$(need_311)
	@echo "topokit: making the environment in $(VENV) (a few minutes, once)"
	@$(PYTHON) -m venv --clear $(VENV)
	@sed '/^# make lab/,$$d' requirements.txt >$(VENV)/lock.txt
	@$(PIP_LOCKED) --requirement $(VENV)/lock.txt
	@sed '/^# its builds on PyPI/,$$d' requirements-torch.txt >$(VENV)/torch-cpu.txt
	@sed '1,/^# its builds on PyPI/d' requirements-torch.txt >$(VENV)/torch.txt
	@$(PIP_LOCKED) --no-index --requirement $(VENV)/torch-cpu.txt 2>/dev/null || $(PIP_LOCKED) --requirement $(VENV)/torch.txt
	@$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@$(BIN)/python -m topokit.rips.engine
	@touch $@

book: env
	@$(BIN)/python book/experiments/report.py book/results/motion.json --out book/report >/dev/null
	@rm -rf _build/html
	@$(BIN)/python book/ahead.py
	@$(BIN)/python -m sphinx -n -W --keep-going -q -b html -c book -d _build/doctrees . _build/html
	@echo "The book: file://$(CURDIR)/_build/html/index.html"

pdf: book
	@$(BIN)/python book/on_paper.py

# The system's own Chromium, driven by Playwright: no browser is fetched.
BROWSER := .venv-browser
$(BROWSER)/ready: pyproject.toml
	$(need_311)
	$(PYTHON) -m venv --clear $(BROWSER)
	$(BROWSER)/bin/python -m pip install --quiet $(call group,browser)
	@touch $@

check-book: $(BROWSER)/ready
	$(BROWSER)/bin/pytest -o addopts= -o filterwarnings= -ra -n auto book/tests

test: env lint
	$(BIN)/python -m pytest -n auto --dist loadfile
	$(BIN)/python book/ahead.py

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/nbstripout --keep-id --verify notebooks/*.ipynb

# JupyterLab is the second part of the lock.
$(VENV)/lab: $(VENV)/ready
	@$(BIN)/python -m pip install --quiet --require-hashes --no-deps --requirement requirements.txt
	@touch $@

lab: $(VENV)/lab
	@$(BIN)/python book/lab.py
	$(BIN)/jupyter lab $(if $(filter 0,$(shell id -u)),--allow-root) --ServerApp.root_dir=$(CURDIR)/runs/lab --LabApp.default_url=/lab/tree/$(firstword $(sort $(wildcard notebooks/*.ipynb)))

clean:
	rm -rf .venv .venv-* _build build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis *.egg-info
