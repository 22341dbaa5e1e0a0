# Needs Python 3.10-3.13, make and a package registry; everything else goes into .venv.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
BENCH_STAMP := $(VENV)/.bench-installed

.DEFAULT_GOAL := help
.PHONY: help install demo test test-faults lint format bench lock clean

help:  ## show the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 18

install: $(STAMP)  ## build .venv with the locked packages and the `morph` command

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; ok = (3, 10) <= sys.version_info[:2] <= (3, 13); \
	ok or sys.exit("This project needs Python 3.10-3.13, and $(PYTHON) is %d.%d. Choose another: make PYTHON=python3.12" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

demo: install  ## start the service, submit a morph, show its progress, fetch and print the result
	$(BIN)/python examples/service_demo.py

test: install  ## run the whole test suite
	$(BIN)/python -m pytest

test-faults: install  ## kill, stop, cut and corrupt what runs, on SQLite and Postgres; 10 minutes
	$(BIN)/python -m pytest -m faults

lint: install  ## style, types and import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install  ## rewrite the code in the project's style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: install $(BENCH_STAMP)  ## speed against peers measured in the same run
	$(BIN)/python -m benchmarks

$(BENCH_STAMP): requirements-bench.lock $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-bench.lock
	@touch $@

lock:  ## resolve the versions again (needs uv)
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra dev -o requirements.lock pyproject.toml
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra bench -c requirements.lock -o requirements-bench.lock pyproject.toml

clean:  ## remove .venv and caches
	rm -rf demo-data $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
