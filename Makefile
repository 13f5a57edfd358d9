# One command each: `make demo`, `make test`, `make check`. Set-up happens once, in .venv.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
# Python, with compiled kernels kept where `ogm` keeps them.
PYTHON_WITH_KERNELS := $(BIN)/python -m ogm_services.runtime.kernel_cache $(BIN)/python

.PHONY: demo test test-ros2 test-clients test-web check coverage format pictures page-picture variants costs bench bench-quick soak clean

demo: $(VENV)/.run
	@$(BIN)/ogm demo $(ARGS)

# Three processes for two cores (tests/conftest.py), each with files of its own; the services' many short files come
# last, so that all end together. A test that hangs takes its process along, and ends the run: pytest-xdist would wait
# for ever for the process that took its place.
PARALLEL := -n auto --maxprocesses 8 --max-worker-restart 0 --dist loadfile --no-loadscope-reorder

# Tests that want programs by others.
WITNESSED := tests/ros2 tests/e2e/test_ros2_played.py
GENERATED := tests/services/test_generated_clients.py
# Tests of the live page, in Chromium.
WEB := tests/web

test: $(VENV)/.dev
	$(BIN)/python -m pytest $(PARALLEL) $(addprefix --ignore ,$(WITNESSED) $(GENERATED) $(WEB)) $(ARGS)

# What ROS 2's own programs, and others, make of what is written, and what is made of theirs: CONTRIBUTING.md.
test-ros2: $(VENV)/.dev
	@tests/ros2/install.sh $(BIN)/python build/ros2
	$(BIN)/python -m pytest $(WITNESSED) -rs $(ARGS)

# Clients in Python and TypeScript that others' programs make of /openapi.json.
test-clients: $(VENV)/.clients
	@tests/generated/install.sh build/clients
	$(BIN)/python -m pytest $(GENERATED) -rs $(ARGS)

# The live page as a browser shows it, driven by Playwright; pictures of it are left in build/web.
test-web: $(VENV)/.web
	@tests/web/install.sh
	$(BIN)/python -m pytest $(WEB) -rs $(ARGS)

# What the tests of the core run, kernels included: as plain Python, many times slower, and with a warning where a kernel
# counts on bytes that wrap around.
coverage: $(VENV)/.dev
	NUMBA_DISABLE_JIT=1 $(BIN)/python -m pytest $(PARALLEL) tests/core -W "ignore:overflow encountered:RuntimeWarning" \
		--cov=ogm_core --cov-branch --cov-report=term-missing:skip-covered $(ARGS)

check: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: $(VENV)/.dev
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

# The maps that README.md and docs show: one lap through each of the simulated worlds, the office's in both cell models.
pictures: $(VENV)/.dev
	$(call picture,lab,220)
	$(call picture,office,3675)
	$(BIN)/ogm build build/pictures/lab.jsonl.gz --preset lab --world lab --out build/pictures/textbook \
		--figure docs/textbook.png
	$(BIN)/ogm build build/pictures/office.jsonl.gz --cell-model rate --out build/pictures/office-rate
	$(BIN)/python -m docs.corner build/pictures/office build/pictures/office-rate docs/corner.png

define picture
mkdir -p build/pictures
$(BIN)/ogm simulate --world $(1) --scans $(2) --seed 1 --out build/pictures/$(1).jsonl.gz
$(BIN)/ogm build build/pictures/$(1).jsonl.gz --out build/pictures/$(1)
cp build/pictures/$(1)/map.png docs/$(1).png
endef

# The live page that README.md and docs show, half way through the office and in the lab: three minutes, and Chromium.
page-picture: $(VENV)/.web
	$(BIN)/python -m docs.page_picture $(ARGS)

# The tables of docs/variants.md.
variants: $(VENV)/.run
	$(BIN)/python docs/variants.py

# The tables of docs/costs.md and its figure; best while nothing else is running.
costs: $(VENV)/.dev
	$(PYTHON_WITH_KERNELS) -m docs.costs

# How fast the map is, against other programs of its kind where g++ and their headers are installed, and how fast
# the services are: OGM_DATASETS and wrk make it complete.
bench: $(VENV)/.run
	$(PYTHON_WITH_KERNELS) -m benchmarks $(ARGS)

# The same in about a minute, with fewer scans and rounds.
bench-quick: $(VENV)/.run
	$(PYTHON_WITH_KERNELS) -m benchmarks --quick $(ARGS)

# The long versions of what the tests hold, and the tables of docs/guarantees.md: an hour, nothing else running.
soak: $(VENV)/.soak
	$(PYTHON_WITH_KERNELS) -m tests.soak $(ARGS)

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
	find . -name __pycache__ -type d -prune -exec rm -rf {} +

$(BIN)/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.run: pyproject.toml | $(BIN)/python
	@echo "Installing into $(VENV), once: 140 MB to download, 0.6 GB on disk, a minute or so."
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable .
	@touch $@

$(VENV)/.dev: pyproject.toml | $(BIN)/python
	@echo "Installing into $(VENV), once, with the tools of development: 0.9 GB on disk, a minute or two."
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	@touch $@ $(VENV)/.run

$(VENV)/.clients: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,clients]'
	@touch $@

$(VENV)/.web: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,web-test]'
	@touch $@

$(VENV)/.soak: $(VENV)/.dev
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev,soak]'
	@touch $@
