SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DEFAULT_GOAL := help

VENV := .venv
STAMP := $(VENV)/.installed
BIN := $(VENV)/bin
# The first Python that is new enough; name another with make PYTHON=/path/to/python.
PYTHON ?= $(shell for p in python3 python3.13 python3.12 python3.11; do \
	$$p -c 'import sys; sys.exit(sys.version_info < (3, 11))' >/dev/null 2>&1 && echo $$p && break; done)
JOBS ?= 2
# One thread in each process: small matrices are far slower on two busy cores with more.
export OMP_NUM_THREADS ?= 1
export PIP_DISABLE_PIP_VERSION_CHECK := 1

.PHONY: help venv demo test docs lint hooks bench system

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / { printf "make %-6s %s\n", $$1, $$2 }' $(MAKEFILE_LIST)

venv: $(STAMP) ## set up .venv, which every target below does by itself

demo: $(STAMP) ## run the experiments of the paper; results go to runs/
	@for name in passing_over reach_to_grasp handover; do \
		echo "== $$name"; $(BIN)/python experiments/$$name.py; done

test: $(STAMP) ## run all tests
	@$(BIN)/python -m pytest -q -n $(JOBS)

docs: $(STAMP) ## build the documentation into docs/_build/html
	@$(BIN)/python -m sphinx -q -W --keep-going -b html docs docs/_build/html
	@echo "Open docs/_build/html/index.html."

lint: $(STAMP) ## check style, types and the direction of imports
	@test ! -d .git || $(BIN)/pre-commit run --all-files
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/pyright --warnings
	@$(BIN)/lint-imports --no-logo --no-cache

hooks: $(STAMP) ## check style at every commit from now on
	@$(BIN)/pre-commit install

bench: $(STAMP) ## time the core operations and perception
	@for name in core perception; do $(BIN)/python experiments/benchmarks/$$name.py; done

system:
	@test -n "$(PYTHON)" || { echo "Python 3.11 or newer is missing; install it, or name it: make PYTHON=/path/to/python3" >&2; exit 1; }
	@$(PYTHON) .ci/system.py

$(STAMP): pyproject.toml constraints.txt | system
	@test -x $(BIN)/python || { echo "Setting up $(VENV), once (1-2 minutes)."; $(PYTHON) -m venv $(VENV); }
	@$(BIN)/python -m pip install --quiet -c constraints.txt -e '.[test,lint,docs]'
	@touch $@
