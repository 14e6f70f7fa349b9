PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

.PHONY: demo docs links test test-all durations torture coverage lint bench dist clean

PIP_INSTALL := $(BIN)/python -m pip install --quiet --disable-pip-version-check
SOURCES := $(shell find src examples -type f -not -path '*/__pycache__/*')

# A copy in .venv, so that bytecode and compiled code lie there too, and nothing in a cache of pip's: neither of the pip
# that is called nor of those that it starts, which get no options but the environment. Where the checkout itself is
# installed, for tests or documentation, it stays.
$(VENV)/.installed: export PIP_NO_CACHE_DIR := 1
$(VENV)/.installed: export PIP_DISABLE_PIP_VERSION_CHECK := 1
$(VENV)/.installed: pyproject.toml $(SOURCES)
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	@test -e $(VENV)/.editable || $(PIP_INSTALL) .
	@touch $@

$(VENV)/.installed-dev: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --editable ".[dev]"
	@touch $(VENV)/.editable $@

$(VENV)/.installed-docs: pyproject.toml
	@test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	$(PIP_INSTALL) --editable ".[docs]"
	@touch $(VENV)/.editable $@

demo: $(VENV)/.installed
	$(BIN)/cornercase demo x-intersection --output demo/x-intersection

# Tests start hundreds of processes, each of which would compile the package anew where nothing may be kept.
test test-all durations coverage: export PYTHONDONTWRITEBYTECODE :=

test: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2

test-all: $(VENV)/.installed-dev
	OPENBLAS_NUM_THREADS=2 OMP_NUM_THREADS=2 $(BIN)/python -m pytest -n 2 -m "not torture"

# Which tests take longest: seconds of the processor, once what is compiled has been kept.
durations: $(VENV)/.installed-dev
	$(BIN)/cornercase warm-up
	$(BIN)/python -m pytest -n 2 --cpu-times

torture: $(VENV)/.installed-dev
	$(BIN)/python -m pytest tests/reliability -m torture -s

coverage: $(VENV)/.installed-dev
	$(BIN)/python -m pytest -n 2 -m "not torture" --cov --cov-report=term --cov-fail-under=90

lint: $(VENV)/.installed-dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python -m lint

docs: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -W --keep-going -q docs docs/_build/html
	@echo "The documentation is docs/_build/html/index.html"

# Links of the documentation to other sites, which needs the network.
links: $(VENV)/.installed-docs
	$(BIN)/python -m sphinx -b linkcheck -D sphinx_gallery_conf.plot_gallery=0 -q docs docs/_build/links

bench: $(VENV)/.installed-dev
	$(PIP_INSTALL) --editable ".[bench]"
	for benchmark in benchmarks/*.py; do $(BIN)/python $$benchmark --quick || exit 1; done

# Wheels and sdist, looked at as an index would: a wheel for all, and one with machine code for this Python and platform.
dist: $(VENV)/.installed-dev
	$(PIP_INSTALL) build check-wheel-contents twine
	rm -rf dist
	$(BIN)/python -m build
	CORNERCASE_COMPILE=1 $(BIN)/python -m build --wheel
	$(BIN)/python -m twine check --strict dist/*
	$(BIN)/check-wheel-contents dist/*.whl

clean:
	rm -rf $(VENV) demo build dist docs/_build docs/gallery docs/reference/api .pytest_cache .mypy_cache .ruff_cache .hypothesis .coverage*
