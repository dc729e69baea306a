# Two commands do everything on a fresh Debian or Ubuntu with Python 3.11, git and make: `make dataset` and `make test`.
define HELP
make dataset    sets up, fetches assets, renders a small dataset, verifies it, makes a contact sheet
                (1 to 5 minutes for setting up, 5 to 10 for the rest on two idle cores)
make test       sets up and runs every test, several files at once
make quick      in a minute and a half, what a change of pure code needs
make train      renders or reuses a training set, trains the slim 2D model for 15 minutes, and evaluates it
make figures    renders or reuses a set that nothing learnt from, and evaluates the ready-made model on it (90 minutes)
make docs       the documents as a site, in out/site, with a light mixer of two small scenes
make check      format, lints, types, who imports what
make format     puts format and imports right
make web        builds the light mixer's page from web/ (needs Node)
make assets     sets up and fetches assets and what renders fast
make clean      removes all that these made here

Variables of make dataset: OUT=out/dataset SCENES=… SEED=… WORKERS=… CONFIG=file.toml
endef
export HELP

OUT ?= out/dataset
SCENES ?=
SEED ?=
WORKERS ?=
CONFIG ?=
PYTHON ?= $(shell command -v python3.11 || command -v python3)

BIN := .venv/bin
MULTILIGHT := $(BIN)/multilight
PIP := $(BIN)/pip -qq --disable-pip-version-check --no-input install -c constraints.txt
OPTIONS := $(if $(SCENES),--scenes $(SCENES)) $(if $(SEED),--seed $(SEED)) \
	$(if $(WORKERS),--workers $(WORKERS)) $(if $(CONFIG),--config $(CONFIG),--preset demo)
# What bpy and Dr.Jit link against and a bare system lacks. Without root they are unpacked into .venv/system.
LIBRARIES := libx11-6 libxcb1 libxau6 libxdmcp6 libbsd0 libmd0 libxrender1 libxfixes3 libxi6 libxext6 libxkbcommon0 \
	libsm6 libice6 libuuid1 libgl1 libglx0 libglvnd0 libgomp1 libatomic1
# A file's tests stay in one process, which keeps what they share; the order is that of `tests/conftest.py`.
PARALLEL := -n logical --maxprocesses 8 --dist loadfile --no-loadscope-reorder
QUICK := tests/lights tests/scenes/files tests/datagen/test_compose.py tests/datagen/test_config.py tests/datagen/test_residuals.py \
	tests/datagen/test_text.py tests/model/test_losses.py tests/model/test_metrics.py tests/test_boundaries.py tests/test_documents.py
AS_ROOT := $(filter 0,$(shell id -u))

.PHONY: help dataset assets test quick train figures docs check format web chromium clean system-libraries
.DEFAULT_GOAL := help
unexport PYTHONDONTWRITEBYTECODE  # tests and workers start hundreds of processes

help:
	@echo "$$HELP"

dataset: assets
	$(MULTILIGHT) dataset --out $(OUT) $(OPTIONS)
	@if [ $(OUT)/contact_sheet.png -nt $(OUT)/index.parquet ]; then \
		echo "contact sheet: $(OUT)/contact_sheet.png"; \
	else \
		$(MULTILIGHT) verify $(OUT) && $(MULTILIGHT) sheet $(OUT) --out $(OUT)/contact_sheet.png; \
	fi

assets: .venv/installed
	@$(MULTILIGHT) assets fetch || echo "Going on with what there is: built-in objects and Blender's own environments."
	@$(MULTILIGHT) doctor --fetch || echo "Going on without LLVM, more slowly: with Blender's Cycles."

test: .venv/installed-dev assets chromium $(if $(shell command -v npm),web/node_modules/.package-lock.json)
	$(BIN)/pytest $(PARALLEL)

quick: .venv/installed-dev
	$(BIN)/pytest $(PARALLEL) -m "not slow" $(QUICK)

train: .venv/installed-train assets
	$(MULTILIGHT) dataset --preset training --out out/training
	$(MULTILIGHT) pack out/training --out out/training-packed
	$(MULTILIGHT) train slim --data out/training-packed --out out/slim
	$(MULTILIGHT) evaluate out/training-packed --size 192 --weights out/slim/model.safetensors --out out/slim/evaluation

figures: .venv/installed-train assets
	$(MULTILIGHT) dataset --preset held_out --out out/held-out
	$(MULTILIGHT) pack out/held-out --out out/held-out-packed
	for lighting in stored random wild; do \
		$(MULTILIGHT) evaluate out/held-out-packed --groups 1000 --size 192 --lighting $$lighting --out out/figures/$$lighting || exit; \
	done
	$(MULTILIGHT) evaluate out/held-out-packed --groups 60 --size 192 --lighting stored --variants --out out/figures/faults

docs: .venv/installed-dev assets
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --quiet
	@echo "site: out/site/index.html; its light mixer wants a server: $(BIN)/python -m http.server --directory out/site"

check: .venv/installed-dev
	$(BIN)/ruff format --check
	$(BIN)/ruff check
	$(BIN)/mypy
	$(BIN)/pytest -q tests/test_boundaries.py

format: .venv/installed-dev
	$(BIN)/ruff format
	$(BIN)/ruff check --fix

web: web/node_modules/.package-lock.json
	cd web && npm run build

# What the page is tested with besides; without it those tests say so and are passed over.
web/node_modules/.package-lock.json: web/package-lock.json
	@cd web && npm ci --silent --no-audit --no-fund && touch node_modules/.package-lock.json || echo "Going on without web/node_modules."

chromium:
	@command -v chromium >/dev/null || command -v google-chrome >/dev/null || $(if $(AS_ROOT),{ apt-get update -qq && \
		DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends chromium; } ||) \
		echo "Going on without Chromium: the page of multilight view is not tested."

clean:
	rm -rf .venv out build web/node_modules *.egg-info .pytest_cache .mypy_cache .ruff_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

system-libraries: .venv/python
ifdef AS_ROOT
	@echo "Installing system libraries that Blender and Mitsuba link against (about a minute) ..."
	@apt-get update -qq
	@DEBIAN_FRONTEND=noninteractive apt-get install -qq -y --no-install-recommends $(LIBRARIES)
else
	@echo "Unpacking system libraries that Blender and Mitsuba link against into .venv/system (about a minute) ..."
	@mkdir -p .venv/system
	@cd .venv/system && apt-get download -qq $(LIBRARIES) && for deb in *.deb; do dpkg-deb -x $$deb .; done && rm -f *.deb
endif

.venv/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info[:2] != (3, 11))' || \
		{ echo "Python 3.11 is needed (bpy's wheels demand it); set PYTHON=/path/to/python3.11"; exit 1; }
	@$(PYTHON) -c 'import ensurepip' 2>/dev/null || $(if $(AS_ROOT),{ apt-get update -qq && \
		apt-get install -qq -y --no-install-recommends python3.11-venv; },{ echo \
		"Python's venv module is incomplete; run: sudo apt-get install python3.11-venv"; exit 1; })
	@$(PYTHON) -m venv .venv
	@touch $@

.venv/installed: .venv/python pyproject.toml constraints.txt
	@echo "Setting up .venv with Blender, Mitsuba and what they need (1 to 5 minutes, 3 GB) ..."
	@$(PIP) -e '.[render]'
	@$(BIN)/python -c 'from multilight.datagen.backends import blender; import drjit' 2>/dev/null || $(MAKE) --no-print-directory system-libraries
	@touch $@

.venv/installed-train: .venv/installed
	@echo "Adding torch (about a minute) ..."
	@$(PIP) -e '.[render,train]'
	@touch $@

.venv/installed-dev: .venv/installed
	@echo "Adding torch and what the tests need (1 to 3 minutes) ..."
	@$(PIP) -e '.[dev]'
	@touch $@
