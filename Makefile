# `make demo` and `make test` set up all they need: virtual environment, dependencies and, where apt and the right to
# use it are there, the OpenGL libraries of the stencil backend.
SHELL := /bin/bash
.SHELLFLAGS := -eu -o pipefail -c
.DELETE_ON_ERROR:
# Where writing of bytecode is switched off, every process would compile every import anew.
unexport PYTHONDONTWRITEBYTECODE

VENV := .venv
# Locked, or newest or oldest of the ranges in pyproject.toml.
export VERSIONS := locked
BIN := $(VENV)/bin
# Four at a time: the suite is made for two cores, and much of the time a worker waits for what its test has started.
# Tests of one file stay together and share its fixtures.
# A worker that dies ends the run: started anew, it may wait for ever for the tests of the one before it.
PYTEST := $(BIN)/python -m pytest -q -n 4 --dist loadfile --max-worker-restart 0 $(PYTEST_OPTIONS)

.PHONY: help setup lock newest oldest demo test test-quick test-slow test-long test-bounds lint types format map docs wheel container benchmark tables benchmark-gpu benchmark-curves mutants viewer clean

help: ## Show the targets
	@grep -E '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 14

# What the demo runs on is a part of what tests, types and the documentation need.
$(VENV)/runs: pyproject.toml .ci/setup .ci/lock.txt
	@.ci/setup $(VENV)
	@touch $@

$(VENV)/ready: pyproject.toml .ci/setup .ci/lock.txt
	@.ci/setup $(VENV) test,docs
	@touch $(VENV)/runs $@

setup: $(VENV)/ready ## Make the virtual environment and install everything into it

lock: setup ## Lock the newest versions that fit pyproject.toml, for every Python supported
	@.ci/lock --upgrade

newest: ## `make test` with the newest versions that pyproject.toml allows, in an environment of its own; says what moved
	@$(MAKE) --no-print-directory VENV=build/newest VERSIONS=newest test

# What was no warning in their day is none of ours.
oldest: ## The quick tests with the oldest versions that pyproject.toml allows, in an environment of their own
	@$(MAKE) --no-print-directory VENV=build/oldest VERSIONS=oldest PYTEST_OPTIONS='-W ignore::DeprecationWarning -W ignore::SyntaxWarning' test-quick

demo: $(VENV)/runs ## Slice, cross-check, fit, partition and program the demo part; the report is demo/run/report.html
	@$(BIN)/ebamcheck warm
	@mkdir -p demo
	@rm -rf demo/run
	@$(BIN)/python -m ebamcheck_models blade --tolerance 0.1 -o demo/blade.stl
	@$(BIN)/python -m ebamcheck_models blade --tolerance 0.005 -o demo/blade-fine.stl
	@$(BIN)/ebamcheck run demo/blade.stl --reference demo/blade-fine.stl -o demo/run
	@echo "Open demo/run/report.html"

test: setup lint ## Lint, types, import contracts, doctests and all quick tests
	@$(BIN)/ebamcheck warm
	@$(MAKE) --no-print-directory -j2 types test-quick

test-quick: setup
	@$(PYTEST) -m "not slow and not long" --doctest-modules ebamcheck backends reference_models reports/ebamcheck_reports reports/viewer/ebamcheck_viewer benchmarks tests

test-slow: setup ## The tests that take longer
	@$(BIN)/ebamcheck warm
	@$(PYTEST) -m "slow and not long" tests

test-long: setup ## The tests that take minutes
	@$(BIN)/ebamcheck warm
	@$(PYTEST) -m long tests

test-bounds: export NUMBA_BOUNDSCHECK := 1
test-bounds: export NUMBA_CACHE_DIR := $(CURDIR)/build/checked-kernels
test-bounds: setup ## The quick tests, and all cases of those in turn, with kernels that check every index: without, a wrong one reads or writes anywhere
	@mkdir -p $(NUMBA_CACHE_DIR)
	@$(BIN)/ebamcheck warm
	@$(PYTEST) -m "(not slow or in_turn) and not long" tests

lint: setup
	@$(BIN)/ruff check .
	@$(BIN)/ruff format --check .
	@$(BIN)/lint-imports --no-cache

types: setup
	@$(BIN)/mypy

format: setup ## Format the code
	@$(BIN)/ruff check --fix .
	@$(BIN)/ruff format .

map: setup ## Make docs/map.md from the docstrings
	@$(BIN)/python docs/make_map.py

docs: setup ## Build the documentation into site/, with warnings as errors
	@NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet --strict

wheel: setup ## Build a wheel into dist/
	@rm -rf dist
	@$(BIN)/python -m build --wheel --no-isolation --outdir dist

container: ## Build a container that brings its kernels compiled, where podman or docker is there
	@engine=$$(command -v podman || command -v docker) || { echo "neither podman nor docker is there" >&2; exit 2; }; \
	"$$engine" info >/dev/null 2>&1 || { echo "$$engine is there, but does not answer: start its service, or install podman" >&2; exit 2; }; \
	"$$engine" build $(CONTAINER_OPTIONS) -f .ci/Containerfile -t ebamcheck .

benchmark: setup ## Time every slicer on the ladder; tables and plots in reports/benchmarks (an hour or two)
	@$(BIN)/ebamcheck warm
	@$(BIN)/python -m benchmarks

tables: setup demo ## Make all tables anew that README and docs quote beside those of `make benchmark` (some hours)
	@$(BIN)/python -m benchmarks.acceptance --again
	@$(BIN)/python -m benchmarks.faults
	@$(BIN)/python -m benchmarks.live demo/run --part demo/blade.stl
	@$(BIN)/python -m benchmarks.orders
	@$(BIN)/python -m benchmarks.curves --layers 3 --stack 200

benchmark-gpu: setup ## The stencil alone, under the name of its renderer
	@$(BIN)/ebamcheck warm
	@$(BIN)/python -m benchmarks --gpu

benchmark-curves: setup ## How much of a part its curves give back; tables in reports/curves (a quarter of an hour)
	@$(BIN)/python -m benchmarks.curves

mutants: setup ## Plant wrong changes of the code, two a room, and count the tests that find them (a quarter of an hour)
	@$(BIN)/ebamcheck warm
	@$(BIN)/python -m benchmarks.mutants -o reports/benchmarks/mutants.md

viewer: ## Bundle the sources of the viewer into the files that the wheel ships (needs node)
	@cd reports/viewer && npm install --silent --no-audit --no-fund --no-package-lock && npm run --silent types && npm run --silent build

clean: ## Remove what the targets made
	@rm -rf $(VENV) demo site .mypy_cache .ruff_cache .pytest_cache .hypothesis
