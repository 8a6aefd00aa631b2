# Set-up, demo, tests. Each target installs what it needs; the second time that costs a second.
SHELL := /bin/bash
SYSTEM_PYTHON ?= /usr/bin/python3
VENV := .venv
BIN := $(VENV)/bin
RANKS ?= 2
# files are shared out among the cores; those of a file share what they solve
PYTEST := $(BIN)/python -m pytest -n auto --dist loadfile
OUTPUT ?= runs/demo

APT := python3-venv python3-numpy python3-petsc4py libpetsc-real-dev python3-mpi4py \
       python3-h5py-mpi openmpi-bin
export OMPI_ALLOW_RUN_AS_ROOT := 1
export OMPI_ALLOW_RUN_AS_ROOT_CONFIRM := 1

.PHONY: demo test lint verify tables bench setup clean particles
setup: $(VENV)/.ready

demo: setup
	$(BIN)/scaleup simulate --geometry drum --ranks $(RANKS) --output $(OUTPUT) --overwrite

# the engine of `scaleup particles`; everything else works without it
particles: setup
	tools/system_packages liggghts

test: setup lint
	-tools/system_packages liggghts
	$(PYTEST)

verify: setup
	$(PYTEST) -m "slow or not slow"

tables: setup
	$(BIN)/python tools/verification_tables.py

bench: setup
	$(BIN)/python benchmarks/mixing_speed.py

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

clean:
	rm -rf $(VENV)

# The system's numpy is kept: Debian's petsc4py was compiled against it. h5py, mpi4py and petsc4py
# are the system's, all on one MPI; pip would put a serial h5py in front of the parallel one.
$(VENV)/.ready: pyproject.toml Makefile tools/system_packages
	@SYSTEM_PYTHON=$(SYSTEM_PYTHON) tools/system_packages $(APT)
	@test -x $(BIN)/python || $(SYSTEM_PYTHON) -m venv --system-site-packages $(VENV) || { \
	  rm -rf $(VENV); echo "Error: no virtual environment could be made; install python3-venv" >&2; exit 1; }
	@$(BIN)/python -c 'import numpy; print("numpy==" + numpy.__version__)' > $(VENV)/constraints.txt
	@$(BIN)/python -m pip install --quiet --disable-pip-version-check \
	  -c $(VENV)/constraints.txt -e '.[dev]' || { \
	  echo "Error: pip could not install the packages of pyproject.toml; is a package index reachable?" >&2; exit 1; }
	@$(BIN)/scaleup doctor --ranks 2
	@touch $@
