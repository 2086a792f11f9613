# make book   build the environment if needed, run every chapter on data_small, build the HTML book
# make test   the same environment; unit tests, doctests, notebooks, lint
# make core   the small library alone, in an environment with NumPy, SciPy and numba, under any Python that it supports (PYTHON=...)
# make lab    open JupyterLab on the first chapter
# make clean  remove what the others made (environments, book, caches)

IS_311 := -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'
PYTHON ?= $(shell for p in python3.11 python3 python; do $$p $(IS_311) 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
export PYTHONHASHSEED = 0
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: book test core lint lab env clean help
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# //p' Makefile

book: env opengl
	@$(BIN)/python -m topokit report book/results/evaluation.json --out book/report >/dev/null
	@$(BIN)/python -m sphinx -n -W --keep-going -q -j auto -b html -c book . _build/html
	@echo "The book: file://$(CURDIR)/_build/html/index.html"

test: env opengl lint
	$(BIN)/python -m pytest -n auto --dist loadfile
	$(BIN)/python -m pytest -n auto --nbmake notebooks/ -o addopts=""

# The wheel as a user gets it, imported from outside the checkout: what the core needs must be in it.
CORE := .venv-core
CORE_BIN := $(CORE)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
CORE_TESTS := sampling rips rips_properties cycles reduction seqph linking mixture io core
core:
	$(PYTHON) -m venv --clear $(CORE)
	$(CORE_BIN)/python -m pip install --quiet . gudhi hypothesis 'pytest<10' scikit-learn
	$(CORE_BIN)/pytest -o addopts= --import-mode=append $(CORE_TESTS:%=tests/test_%.py)

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/nbstripout --keep-id --verify notebooks/*.ipynb

lab: env opengl
	$(BIN)/jupyter lab notebooks/00_an_apron_finds_its_hook.ipynb

# The environment is rebuilt when the requirements or the package's own metadata change.
env: $(READY)
$(READY): requirements.txt pyproject.toml
	@$(or $(PYTHON),false) $(IS_311) 2>/dev/null || { echo "topokit: needs Python 3.11$(if $(PYTHON), and '$(PYTHON)' is not that):\
	 install it, or name it (make PYTHON=/path/to/python3.11 ...), or for other versions: conda env create -f environment.yml" >&2; exit 1; }
	@echo "topokit: making the environment in $(VENV) (a few minutes, once)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python -m pip install --quiet --requirement requirements.txt
	@$(BIN)/python -m pip install --quiet --no-deps --editable .
	@touch $(READY)

.PHONY: opengl
opengl: env
	@$(BIN)/python -c 'from topokit.view import pyvista_works; ok, why = pyvista_works(); ok or print("topokit:", why)'

clean:
	rm -rf $(VENV) $(CORE) _build build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis *.egg-info
