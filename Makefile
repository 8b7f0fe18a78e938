# What a newcomer types: `make render`, `make test`. Needs a Rust toolchain, a C compiler and Python 3.10 or newer;
# everything else comes into .venv. Another Python: `make PYTHON=python3.12 render`.

PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
INSTALLED := $(VENV)/.installed
TEST_INSTALLED := $(VENV)/.installed-test
SOURCES := pyproject.toml Cargo.toml Cargo.lock \
    $(shell find src hydra_bridge -type f \( -name '*.rs' -o -name '*.toml' -o -name '*.py' -o -name '*.pyi' -o -name '*.json' \))

# pyo3 asks this interpreter for its build settings, also under clippy and rustdoc.
export PYO3_PYTHON := $(CURDIR)/$(BIN)/python

.PHONY: render test stability needs scaling bench-lights bench-training bench-rays bench-steps flat-scenes lint format clean
.DELETE_ON_ERROR:

render: $(INSTALLED)
	mkdir -p out
	$(BIN)/dermis record usd_scenes/orc.usda out/orc.exr --displayImage out/orc.png --progress bar

# Python's tests two files at a time: much of what they do is one thread's work. Fixtures of a file are made once.
test: $(TEST_INSTALLED) lint
	cargo test --release
	$(BIN)/python -m pytest -n 2 --dist loadfile

# The hard cases, some minutes: out/stability.html and out/stability.csv.
stability: $(TEST_INSTALLED)
	PYTHONPATH=tests $(BIN)/python -m stability --out out

# What capabilities cost, in use and not, some minutes: the table that `dermis explain` and the reports show.
# Instructions are counted by valgrind, where it is installed.
needs: $(TEST_INSTALLED)
	cargo build --release --example phases
	PYTHONPATH=tests $(BIN)/python -m needs --out hydra_bridge/python/dermis/costs.json

# What a sample, a start and a byte cost as scenes grow: out/scaling.csv and out/scaling.png.
scaling: $(TEST_INSTALLED)
	PYTHONPATH=tests $(BIN)/python -m scaling --out out

# Cost and efficiency against the number of lights, some minutes.
bench-lights: $(TEST_INSTALLED)
	$(BIN)/python tests/bench_lights.py

# What training costs and gains at budgets of 1 to 20 seconds, half an hour; stages of ../shared.
bench-training: $(TEST_INSTALLED)
	$(BIN)/python tests/bench_training.py

# dermis beside Embree on the same rays, a few minutes. Embree comes with PyPI's embreex; scenes of ../shared where it is.
RAY_SCENES := $(firstword $(wildcard ../shared/scenes/backlit_bunny.usda) usd_scenes/orc.usda) \
    $(wildcard $(addprefix ../shared/scenes/,card_skull.usda creature_spot.usda envmap_dragon.usda))

FLAT_SCENES := $(foreach stage,$(RAY_SCENES),out/rays/$(basename $(notdir $(stage))).dermis)

flat-scenes: $(INSTALLED)
	mkdir -p out/rays
	for stage in $(RAY_SCENES); do \
	    $(BIN)/dermis flatten $$stage out/rays/$$(basename $$stage .usda).dermis || exit 1; \
	done

bench-rays: flat-scenes
	$(BIN)/python -m pip install --disable-pip-version-check --quiet 'embreex>=4.4,<5' || \
	    echo "bench-rays: pip cannot install embreex here" >&2
	cargo bench --bench rays -- --embree "$$(find $(VENV)/lib -name 'libembree4*' | head -n 1)" \
	    $(FLAT_SCENES)

# Nanoseconds per step of walks in the same bodies, and what of them sampling and the geometry take; some minutes.
bench-steps: flat-scenes
	cargo bench --bench steps -- $(FLAT_SCENES)

lint: $(TEST_INSTALLED)
	cargo fmt --all --check
	cargo clippy --workspace --all-targets -- -D warnings
	RUSTDOCFLAGS="-D warnings" cargo doc --workspace --no-deps
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

format: $(TEST_INSTALLED)
	cargo fmt --all
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

$(BIN)/python:
	@command -v cargo >/dev/null || { echo "cargo not found: install Rust 1.89 or newer (https://rustup.rs)" >&2; exit 1; }
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	    { echo "$(PYTHON) is not Python 3.10 or newer; name one: make PYTHON=python3.12 $(MAKECMDGOALS)" >&2; exit 1; }
	@$(PYTHON) -c 'import venv, ensurepip' || \
	    { echo "$(PYTHON) cannot make virtual environments; on Debian: apt install python3-venv" >&2; exit 1; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)

$(INSTALLED): $(SOURCES) | $(BIN)/python
	$(BIN)/python -m pip install --disable-pip-version-check .
	touch $@

$(TEST_INSTALLED): $(SOURCES) | $(BIN)/python
	$(BIN)/python -m pip install --disable-pip-version-check '.[test]'
	touch $(INSTALLED) $@

clean:
	rm -rf $(VENV) target out .pytest_cache .ruff_cache
