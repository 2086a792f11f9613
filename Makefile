# make book   build the environment if needed, run every chapter on data_small, build the HTML book
# make test   the same environment; unit tests, doctests, notebooks, lint
# make core   the small library alone, in an environment with NumPy, SciPy and numba, under any Python that it supports (PYTHON=...)
# make lowest the same with the lowest versions that pyproject.toml states; EXTRAS="sim data learn sensors view" adds theirs, and every test
# make doors  tests of the doors to neighbours that the environment lacks (Ripser, persim, pyarrow, Rerun, Stable-Baselines3), in one beside it
# make hashes requirements-hashed.txt anew: after every change of requirements.txt
# make supply licences and a bill of materials of the environment, into _build, and an audit for known vulnerabilities
# make pdf    the whole book as one page, and that printed by Chromium
# make check-book  open every page of the built book in Chromium, without a network, and use every control of its figures
# make lab    open JupyterLab on the first chapter
# make clean  remove what the others made (environments, book, caches)

IS_311 := -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))'
PYTHON ?= $(shell for p in python3.11 python3 python; do $$p $(IS_311) 2>/dev/null && echo $$p && break; done)
VENV := .venv
BIN := $(VENV)/bin
READY := $(VENV)/ready
export PYTHONHASHSEED = 0
export PIP_DISABLE_PIP_VERSION_CHECK = 1

.PHONY: book pdf check-book test core lowest doors hashes supply lint lab env clean help
.DEFAULT_GOAL := help

help:
	@sed -n 's/^# make/make/p' Makefile

book: env opengl
	@$(BIN)/python -m topokit report book/results/motion.json --out book/report >/dev/null
	@rm -rf _build/html
	@$(BIN)/python book/ahead.py
	@$(BIN)/python -m sphinx -n -W --keep-going -q -b html -c book -d _build/doctrees . _build/html
	@echo "The book: file://$(CURDIR)/_build/html/index.html"

pdf: book
	@$(BIN)/python book/on_paper.py

# The system's own Chromium, asked by Playwright: no browser is fetched.
BROWSER := .venv-browser
$(BROWSER)/ready: Makefile
	$(PYTHON) -m venv --clear $(BROWSER)
	$(BROWSER)/bin/python -m pip install --quiet axe-playwright-python==0.1.8 playwright==1.65.2 pytest==9.2.0 pytest-xdist==3.8.0
	@touch $@

check-book: $(BROWSER)/ready
	$(BROWSER)/bin/pytest -o addopts= -o filterwarnings= -ra -n auto book/tests

test: env opengl lint
	$(BIN)/python -m pytest -n auto --dist loadfile
	$(BIN)/python -m pytest -n auto --nbmake notebooks/ -o addopts=""

# The wheel as a user gets it, imported from outside the checkout: what the core needs must be in it.
CORE := .venv-core
CORE_BIN := $(CORE)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
CORE_TESTS := sampling rips rips_properties cycles reduction seqph linking mixture io core
core:
	$(PYTHON) -m venv --clear $(CORE)
	$(CORE_BIN)/python -m pip install --quiet . $(PINS) gudhi hypothesis 'pytest<10' scikit-learn
	$(CORE_BIN)/pytest -o addopts= --import-mode=append $(CORE_TESTS:%=tests/test_%.py)

EXTRAS_TOOLS := pandas psutil pyyaml trimesh
TOOLS := .venv-tools
$(TOOLS)/ready: Makefile
	$(PYTHON) -m venv --clear $(TOOLS)
	$(TOOLS)/bin/python -m pip install --quiet cyclonedx-bom==7.5.0 pip-audit==2.10.1 pip-licenses==5.5.5 uv==0.13.9
	@touch $@

# The tests' own tools are today's. PyBullet and zarr have wheels for Python 3.11 in common.
lowest: $(TOOLS)/ready
	$(TOOLS)/bin/uv pip compile --quiet --no-header --no-annotate --resolution lowest-direct --python $(PYTHON) \
	  $(EXTRAS:%=--extra %) pyproject.toml --output-file $(TOOLS)/lowest.txt
	$(MAKE) core PINS="--requirement $(TOOLS)/lowest.txt $(if $(EXTRAS),$(EXTRAS_TOOLS))" \
	  $(if $(EXTRAS),CORE_TESTS="$(patsubst tests/test_%.py,%,$(filter-out %_repository.py %_docstrings.py,$(wildcard tests/test_*.py)))")

# The neighbours come on top of the environment and leave it as it is.
DOORS := .venv-doors
doors: env
	$(BIN)/python -m venv --clear $(DOORS)
	$(BIN)/python -c "import site; print(site.getsitepackages()[0])" > $(DOORS)/lib/python3.11/site-packages/beside.pth
	$(DOORS)/bin/python -m pip install --quiet --editable '.[pyarrow,rerun,rl]' persim ripser
	$(DOORS)/bin/python -m pytest -o addopts=-ra tests/test_compat*.py tests/test_coming_from.py

# torch stays outside: its builds (CPU, CUDA) come from several indexes, each with hashes of its own.
hashes: $(TOOLS)/ready
	$(TOOLS)/bin/uv pip compile --quiet --generate-hashes --no-deps --no-header --no-annotate --no-emit-package torch \
	  --python-version 3.11 requirements.txt --output-file requirements-hashed.txt

supply: env $(TOOLS)/ready
	@mkdir -p _build
	$(TOOLS)/bin/pip-licenses --python=$(BIN)/python --from=mixed --order=license --output-file=_build/licences.txt
	$(TOOLS)/bin/cyclonedx-py environment $(BIN)/python --pyproject pyproject.toml --output-reproducible --output-file _build/bom.json
	$(TOOLS)/bin/pip-audit --strict --no-deps --disable-pip --requirement requirements.txt

lint: env
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/codespell
	$(BIN)/nbstripout --keep-id --verify notebooks/*.ipynb

lab: env opengl
	$(BIN)/jupyter lab --ServerApp.root_dir=$(CURDIR) --LabApp.default_url=/lab/tree/$(firstword $(sort $(wildcard notebooks/*.ipynb)))

# The environment is rebuilt when the requirements or the package's own metadata change.
env: $(READY)
$(READY): requirements.txt requirements-hashed.txt pyproject.toml
	@$(or $(PYTHON),false) $(IS_311) 2>/dev/null || { echo "topokit: needs Python 3.11$(if $(PYTHON), and '$(PYTHON)' is not that):\
	 install it, or name it (make PYTHON=/path/to/python3.11 ...), or for other versions: conda env create -f environment.yml" >&2; exit 1; }
	@echo "topokit: making the environment in $(VENV) (a few minutes, once)"
	@$(PYTHON) -m venv --clear $(VENV)
	@$(BIN)/python -m pip install --quiet --require-hashes --no-deps --requirement requirements-hashed.txt
	@$(BIN)/python -m pip install --quiet --requirement requirements.txt  # torch==2.13.0, the one that is left
	@$(BIN)/python -m pip install --quiet --no-deps --no-build-isolation --editable .
	@touch $(READY)

.PHONY: opengl
opengl: env
	@$(BIN)/python -c 'from topokit.view import pyvista_works; ok, why = pyvista_works(); ok or print("topokit:", why)'

clean:
	rm -rf $(VENV) $(CORE) $(DOORS) $(TOOLS) $(BROWSER) _build build dist .pytest_cache .ruff_cache .mypy_cache .hypothesis *.egg-info
