# Two commands do everything on a fresh Debian or Ubuntu with Python 3.11, git and make:
#   make dataset    sets up, fetches assets, renders a small dataset, verifies it, makes a contact sheet
#   make test       sets up and runs every test
# Variables: make dataset OUT=… SCENES=… SEED=… WORKERS=… CONFIG=…

OUT ?= out/dataset
SCENES ?=
SEED ?=
WORKERS ?=
CONFIG ?=
PYTHON ?= $(shell command -v python3.11 || command -v python3)

BIN := .venv/bin
MULTILIGHT := $(BIN)/multilight
OPTIONS := $(if $(SCENES),--scenes $(SCENES)) $(if $(SEED),--seed $(SEED)) \
	$(if $(WORKERS),--workers $(WORKERS)) $(if $(CONFIG),--config $(CONFIG))

.PHONY: dataset assets test check format clean
.DEFAULT_GOAL := dataset

dataset: assets
	$(MULTILIGHT) dataset --out $(OUT) $(OPTIONS)
	@if [ $(OUT)/contact_sheet.png -nt $(OUT)/index.parquet ]; then \
		echo "contact sheet: $(OUT)/contact_sheet.png"; \
	else \
		$(MULTILIGHT) verify $(OUT) && $(MULTILIGHT) sheet $(OUT) --out $(OUT)/contact_sheet.png; \
	fi

assets: .venv/installed
	@$(MULTILIGHT) assets fetch || echo "Going on with what there is: built-in objects and Blender's own environments."

test: .venv/installed-dev assets
	$(BIN)/pytest

check: .venv/installed-dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/pytest -q tests/test_boundaries.py

format: .venv/installed-dev
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

clean:
	rm -rf .venv out build *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

.venv/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
		{ echo "Python 3.11 is needed (bpy's wheels demand it); set PYTHON=/path/to/python3.11"; exit 1; }
	$(PYTHON) -m venv .venv
	touch $@

.venv/installed: .venv/python pyproject.toml constraints.txt
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e .
	touch $@

.venv/installed-dev: .venv/installed
	$(BIN)/pip install --quiet --disable-pip-version-check -c constraints.txt -e '.[dev]'
	touch $@
