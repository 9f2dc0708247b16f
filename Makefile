# make demo   run the Duffing experiment, write its report and its animation; a second time replaces the first
# make test   format, lint, types and tests: the gate; real-time tests come last, alone on the machine
# make quick  format, lint and the tests that need no long compilation: the inner loop, under a minute
# make docs-check  every number in README and docs against the code: minutes; OPTIONS=--write writes them anew
# make docs   build the documentation and the reference of the package into site/
# make lock   write the lock files requirements*.txt anew, with the versions they have; OPTIONS=--upgrade takes the latest
# make dist   build a wheel and an sdist into dist/
# make searches  tests that are whole discoveries, beyond one for each verdict and kind of system
# make soak   all faults of a rig, a thousand killed controllers, a million mutated frames, a night of 40 runs, hostile files: half an hour
# make bench  speed against other tools, side by side
# make bench-discovery  identify hidden effects in more than a thousand records, some made by MuJoCo, with PySINDy beside:
#             hours; an interrupted run resumes where it stopped; OPTIONS=--quick is about 30 records
# Each sets itself up in .venv and needs nothing but Python 3.11 or newer.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
BENCH_READY := .venv/ready-bench
DISCOVERY_READY := .venv/ready-bench-discovery
DOCS_READY := .venv/ready-docs
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check
# No file is installed but those whose hashes are in a lock file, and none builds itself, which would fetch others.
LOCKED := $(PIP) --require-hashes --only-binary :all: --requirement
VERSIONS := .venv/versions.txt
LOCK := $(BIN)/uv pip compile --quiet --universal --generate-hashes --no-annotate --no-emit-index-url \
	--custom-compile-command 'make lock' $(OPTIONS) pyproject.toml

QUICK := project/test_architecture project/test_vocabulary project/test_documentation model/declaration/test_registry \
	model/declaration/test_expression model/modelling/test_model model/modelling/test_scales \
	compile/codegen/test_linear_systems model/effects/test_element_effects

# A file is one worker's, the longest first (tests/processor_time.py).
BY_FILE := -n 2 --dist loadfile --no-loadscope-reorder
REALTIME = $(shell grep -rl --include='test_*.py' 'mark\.realtime' tests)

.PHONY: demo test quick searches soak docs docs-check lock dist bench bench-discovery clean

# Machine code is kept between runs of the tests: its names are hashes of all that it is made of.
export MASKING_CACHE ?= $(CURDIR)/.venv/kernels

demo: $(READY)
	$(BIN)/masking run examples/oscillators/duffing.yaml --out results/duffing --overwrite
	$(BIN)/masking animate results/duffing

test: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest $(BY_FILE) -m "not search and not realtime"
	$(BIN)/pytest -m "realtime and not search" $(REALTIME)

searches: $(READY)
	$(BIN)/pytest $(BY_FILE) -m search

quick: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/pytest $(BY_FILE) $(QUICK:%=tests/%.py)

soak: $(READY)
	$(BIN)/python -m tests.campaigns faults
	$(BIN)/python -m tests.benchmarks.soak
	$(BIN)/python -m tests.benchmarks.crashes --kills 100
	$(BIN)/python -m tests.benchmarks.overnight
	$(BIN)/python -m tests.benchmarks.hostile

docs-check: $(READY)
	$(BIN)/python -m tests.documented $(OPTIONS)

docs: $(DOCS_READY)
	$(BIN)/mkdocs build --strict

dist: $(READY)
	HATCH_BUILD_HOOK_ENABLE_CUSTOM=true $(BIN)/python -m build --no-isolation

bench: $(BENCH_READY)
	$(BIN)/python -m tests.benchmarks

bench-discovery: $(DISCOVERY_READY) searches
	$(BIN)/python -m tests.benchmarks.discovering $(OPTIONS)

$(READY): pyproject.toml requirements.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "masking needs Python 3.11 or newer; name one with 'make PYTHON=python3.12'"; exit 1; }
	$(PYTHON) -m venv .venv
	$(LOCKED) requirements.txt
	$(PIP) --no-index --no-deps --no-build-isolation --editable .
	$(BIN)/python -m pip list --format freeze --exclude-editable > $(VERSIONS)
	@touch $@

# Contenders that cannot be installed here are left out of the table, which says so. They are in no lock file: no hash of
# theirs is checked.
$(BENCH_READY): $(READY)
	-$(PIP) --constraint $(VERSIONS) heyoka==7.13.2
	-$(PIP) --constraint $(VERSIONS) casadi
	@touch $@

$(DOCS_READY): $(READY) requirements-docs.txt
	$(LOCKED) requirements-docs.txt
	@touch $@

# Where PySINDy cannot be installed, its columns stay empty and the page says so.
$(DISCOVERY_READY): $(READY)
	-$(PIP) --constraint $(VERSIONS) pysindy
	@touch $@

# Each file has the hashes of every wheel, for all systems and versions of Python that its first package allows.
lock: $(READY)
	$(PIP) uv==0.13.9
	$(LOCK) --extra dev --python-version 3.11 --output-file requirements.txt
	$(LOCK) --extra docs --python-version 3.11.5 --constraint requirements.txt --output-file requirements-docs.txt

clean:
	rm -rf .venv results dist site .mypy_cache .ruff_cache .hypothesis
