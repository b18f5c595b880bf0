# Needs only make and a Python >= 3.11; everything else is installed into .venv.

VENV := .venv
BIN := $(VENV)/bin
PYTHON ?=

.DEFAULT_GOAL := help
.PHONY: help demo test lint docs clean

help: ## show this list
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):[^#]*## /  make \1\t/' | expand -t 16

demo: $(VENV)/.installed-demo ## match the bundled pair of humans; the result goes to clalign-demo/
	$(BIN)/clalign demo

test: $(VENV)/.installed-dev lint ## run the linters and every test
	OMP_NUM_THREADS=1 $(BIN)/python -m pytest

lint: $(VENV)/.installed-dev ## check style, types and the direction of imports
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.installed-dev ## build the documentation into docs/_build/html, with the figures that are missing
	$(BIN)/python docs/gallery.py
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html

clean: ## remove the virtual environment and every cache beside the sources
	rm -rf $(VENV) build dist docs/_build docs/generated .hypothesis .pytest_cache .mypy_cache .ruff_cache .import_linter_cache

# A candidate counts only if it starts: version managers leave commands on the path that do not.
$(VENV)/bin/python:
	@for python in $(PYTHON) python3 python3.14 python3.13 python3.12 python3.11 python; do \
	  "$$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null || continue; \
	  echo "creating $(VENV) with $$("$$python" --version)"; \
	  "$$python" -m venv $(VENV) && exit 0; \
	  rm -rf $(VENV); \
	  echo "error: $$python cannot create virtual environments; on Debian or Ubuntu: apt install python3-venv" >&2; \
	  exit 1; \
	done; \
	echo "error: no Python 3.11 or newer found; install one, or name it: make PYTHON=/path/to/python3" >&2; exit 1

$(VENV)/.installed-demo: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[pocl,plots]'
	@touch $@

$(VENV)/.installed-dev: $(VENV)/bin/python pyproject.toml
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[pocl,plots,dev]'
	@touch $@ $(VENV)/.installed-demo
