# `make run` and `make test` do everything on a machine that has Python 3.11 or newer: .venv, installation, the work.
#   ARGS="estimator=maf seed=1"   what `make run`, `make test` and the benchmarks pass on
#   PYTHON=python3.12             the interpreter that .venv is made with
#   TORCH_INDEX=                  take torch from pip's usual index (with CUDA, on Linux) instead of its CPU build

PYTHON ?= python3
TORCH_INDEX ?= https://download.pytorch.org/whl/cpu
ARGS ?=

# Tests run on every core, on four at most for memory's sake; a file's tests share what they have set up.
SPREAD := -n auto --maxprocesses 4 --dist loadfile

VENV := .venv
PY := $(VENV)/bin/python
STAMP := $(VENV)/.installed

# Where the wheel is tried, outside the checkout.
TRIED := $(or $(TMPDIR),/tmp)/vehicle_sbi_wheel

# Threads are numba's, over simulations: small networks train fastest on one thread, and threads of both kinds collide.
export OMP_NUM_THREADS ?= 1
export OPENBLAS_NUM_THREADS ?= 1
export MKL_NUM_THREADS ?= 1

.DEFAULT_GOAL := help
.PHONY: help install run test test-all docs wheel lint format bench bench-simulator clean

help:  ## this list
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/^([a-z-]+):.*## /make \1\t/' | expand -t 22

install: $(STAMP)  ## the environment in .venv, with pinned dependencies

run: $(STAMP)  ## the paper's study; ARGS="key=value …" changes it
	@$(PY) scripts/run.py $(ARGS)

test: $(STAMP)  ## the tests that take seconds
	@$(PY) -m pytest $(SPREAD) $(ARGS)

test-all: $(STAMP)  ## every test, the slow ones included
	@$(PY) -m pytest $(SPREAD) -m "slow or not slow" $(ARGS)

docs: $(VENV)/.docs  ## the docs as a site in build/docs; a broken link, or a page that no other lists, is an error
	@$(PY) -m sphinx -q -W --keep-going docs build/docs
	@echo build/docs/index.html

wheel: $(STAMP)  ## the wheel, tried in an environment of its own outside the checkout: a study, the demo, three files
	@rm -rf build/wheel $(TRIED) && mkdir -p build/wheel $(TRIED)
	@$(PY) -m pip wheel -q --no-deps -w build/wheel . && $(PYTHON) -m venv $(TRIED)/env
	@test -z "$(TORCH_INDEX)" || $(TRIED)/env/bin/python -m pip install -q --disable-pip-version-check --retries 0 \
		--timeout 15 --no-deps -c constraints.txt --index-url $(TORCH_INDEX) torch >/dev/null 2>&1 || true
	@$(TRIED)/env/bin/python -m pip install -q --disable-pip-version-check -c constraints.txt \
		"$$(ls build/wheel/*.whl)[ros,mdf,can]"
	@cd $(TRIED) && env/bin/vehicle-sbi run experiment=smoke && env/bin/vehicle-sbi demo && \
		test $$(wc -c < outputs/demo/report.html) -lt 5000000
	@VEHICLE_SBI=$(TRIED)/env/bin/vehicle-sbi $(PY) -m pytest -n 2 -m slow tests/test_from_file_to_table.py
	@rm -rf $(TRIED)

lint: $(STAMP)  ## style, formatting and types
	@$(PY) -m ruff check
	@$(PY) -m ruff format --check
	@$(PY) -m pyright

format: $(STAMP)  ## put style and formatting right
	@$(PY) -m ruff check --fix
	@$(PY) -m ruff format

bench: bench-simulator  ## the benchmarks; results in benchmarks/results
	@$(PY) benchmarks/paper_table.py $(ARGS)

bench-simulator: $(STAMP)  ## simulations per second
	@$(PY) benchmarks/simulator.py

clean:  ## forget the environment and all caches; outputs stay
	rm -rf $(VENV) build dist .pytest_cache .ruff_cache .hypothesis *.egg-info
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(PY):
	@command -v $(PYTHON) >/dev/null || { echo "error: no '$(PYTHON)' here; Python 3.11 or newer is needed (PYTHON=… names one)" >&2; exit 2; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "error: $(PYTHON) is $$($(PYTHON) --version 2>&1); Python 3.11 or newer is needed (PYTHON=… names one)" >&2; exit 2; }
	@$(PYTHON) -m venv $(VENV) >/dev/null 2>&1 || \
		{ rm -rf $(VENV); echo "error: '$(PYTHON) -m venv $(VENV)' failed; on Debian and Ubuntu it needs python3-venv" >&2; exit 2; }

# The CPU build of torch is a tenth of the CUDA one. Where its index does not answer, pip's usual index serves torch.
$(STAMP): pyproject.toml constraints.txt | $(PY)
	@echo "installing into $(VENV): a few minutes the first time"
	@test -z "$(TORCH_INDEX)" || $(PY) -c 'import torch' 2>/dev/null || \
		$(PY) -m pip install -q --disable-pip-version-check --retries 0 --timeout 15 --no-deps -c constraints.txt \
			--index-url $(TORCH_INDEX) torch >/dev/null 2>&1 || \
		echo "$(TORCH_INDEX) has no torch for this machine: taking it from pip's usual index"
	@$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[dev]'
	@touch $@
	@echo "installed: $(VENV)/bin/vehicle-sbi lists what it can do; $(VENV)/bin/vehicle-sbi demo shows it"

$(VENV)/.docs: $(STAMP)
	@$(PY) -m pip install -q --disable-pip-version-check -c constraints.txt -e '.[docs]'
	@touch $@
