# Everything a fresh machine needs is Python >= 3.11 with venv, make and git: `make demo`, `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SECONDS ?=
FIGURE ?=

.PHONY: demo test test-fast test-slow check format lint types imports bench clean

demo: $(VENV)/.ready
	$(BIN)/twindctl demo $(if $(SECONDS),--seconds $(SECONDS))

test: $(VENV)/.ready
	$(BIN)/pytest

test-fast: $(VENV)/.ready
	$(BIN)/pytest -n auto -m 'not slow and not realtime'

test-slow: $(VENV)/.ready
	$(BIN)/pytest -m slow

check: format lint types imports test test-slow

format: $(VENV)/.ready
	$(BIN)/ruff format --check .

lint: $(VENV)/.ready
	$(BIN)/ruff check .

types: $(VENV)/.ready
	$(BIN)/mypy

imports: $(VENV)/.ready
	$(BIN)/lint-imports

bench: $(VENV)/.bench
	$(BIN)/python -m bench $(FIGURE)

# The stamp makes a half-finished environment start over.
$(VENV)/.ready: pyproject.toml
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "twind needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev]'
	touch $@

$(VENV)/.bench: $(VENV)/.ready
	$(BIN)/pip install --quiet --disable-pip-version-check --editable '.[dev,bench]'
	touch $@

clean:
	rm -rf $(VENV) dist build .mypy_cache .ruff_cache .pytest_cache .hypothesis
