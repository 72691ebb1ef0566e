# Everything a newcomer needs. `make help` lists it.
# The first one that is new enough, where PYTHON=... names none.
ENOUGH := -c 'import sys; sys.exit(sys.version_info < (3, 11))'
PYTHON ?= $(shell for name in python3 python3.13 python3.12 python3.11; do \
  $$name $(ENOUGH) 2> /dev/null && echo $$name && break; done)
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TOOLS := $(VENV)/.tools
DOCUMENTER := $(VENV)/.documenter
INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check -c constraints.txt
SCENE ?= taylor-green
override SCENE := $(subst _,-,$(SCENE))
SCENES := taylor-green lid-driven-cavity open-cavity

.DEFAULT_GOAL := help

.PHONY: help
help: ## show this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## /{printf "  make %-12s %s\n", $$1, $$2}' $(MAKEFILE_LIST)

$(INSTALLED): pyproject.toml constraints.txt
	@test -n "$(PYTHON)" && $(PYTHON) $(ENOUGH) || { echo "sphrom needs Python 3.11 or later. \
	Name one: make demo PYTHON=/path/to/python3.12" >&2; exit 1; }
	$(PYTHON) -m venv $(VENV)
	$(INSTALL) -e .
	@touch $@

$(TOOLS): $(INSTALLED)
	$(INSTALL) -e '.[dev]'
	@touch $@ $(DOCUMENTER)

$(DOCUMENTER): $(INSTALLED)
	$(INSTALL) -e '.[docs]'
	@touch $@

.PHONY: setup
setup: $(TOOLS) ## make the virtual environment and install, development tools included

.PHONY: demo
demo: $(INSTALLED) ## the whole pipeline on a coarse Taylor-Green vortex, full against reduced
	$(BIN)/sphrom run cases/taylor_green_demo.yaml

# Files are handed out in the order of collection, which begins with the longest.
PARALLEL := -n 2 --dist loadfile --no-loadscope-reorder

.PHONY: test
test: $(TOOLS) ## run the tests, but for the slow ones
	$(BIN)/python -m pytest $(PARALLEL) -m "not slow"

.PHONY: test-all
test-all: $(TOOLS) ## run all tests, with clusters, browsers and every command of the documents
	$(BIN)/python -m pytest $(PARALLEL)

NUMERIC := tests/fit tests/kernels tests/metrics tests/reduction tests/pipeline/test_fit.py
PROCESSORS := $(if $(filter x86_64,$(shell uname -m)),nehalem haswell)
.PHONY: test-processors $(PROCESSORS:%=test-%)
test-processors: $(PROCESSORS:%=test-%) ## run fast numeric tests, compiled for two older processors (x86-64 alone)
# One process each, because two would compile the same kernels; `make -j2` runs both at once.
$(PROCESSORS:%=test-%): test-%: $(TOOLS)
	NUMBA_CPU_NAME=$* NUMBA_CPU_FEATURES= OPENBLAS_CORETYPE=$* SPHROM_CACHE=build/kernels-$* \
	  $(BIN)/python -m pytest -p no:cacheprovider $(NUMERIC)

.PHONY: check
check: $(TOOLS) ## lint, types, import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

.PHONY: docs
docs: $(DOCUMENTER) ## build the documentation, build/docs/index.html; every warning is an error
	rm -rf build/docs
	$(BIN)/python -m sphinx -W --keep-going -q docs build/docs

PYTHONS ?= $(PYTHON)
.PHONY: wheel
wheel: $(INSTALLED) ## build a wheel and use it in an empty folder; PYTHONS="python3.11 python3.12": for each
	$(BIN)/python scripts/try_wheel.py $(PYTHONS)

SMOKE := $(foreach scene,$(SCENES),$(subst -,_,$(scene))_demo) gallery/cylinder
.PHONY: smoke $(SMOKE:%=smoke/%)
smoke: $(SMOKE:%=smoke/%) ## every scene and one of the gallery end to end on a coarse grid, in folders of their own
$(SMOKE:%=smoke/%): smoke/%: $(INSTALLED)
	$(BIN)/sphrom run cases/$*.yaml --out runs/smoke/$* --force

.PHONY: reproduce
reproduce: $(INSTALLED) ## SCENE=...: the paper's experiment, corrected and as printed, on one page; days
	$(BIN)/python scripts/reproduce.py $(SCENE) $(OPTIONS)

.PHONY: reproduce-half
reproduce-half: $(INSTALLED) ## SCENE=...: the same at half size
	$(BIN)/python scripts/reproduce.py $(SCENE) --coarser 2 $(OPTIONS)

.PHONY: clean
clean: ## remove the virtual environment and caches, but no results
	rm -rf $(VENV) build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis .import_linter_cache
