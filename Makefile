# make demo   run the Duffing experiment and write its report
# make test   format, lint, types and tests: the gate
# make bench  speed against other tools, side by side
# make bench-discovery  name what is hidden in more than a thousand records, some made by MuJoCo, PySINDy beside: hours;
#             an interrupted run goes on where it stopped; OPTIONS=--quick is about 30 records
# Each sets itself up in .venv and needs nothing but Python 3.11 or newer.

PYTHON ?= python3
BIN := .venv/bin
READY := .venv/ready
BENCH_READY := .venv/ready-bench
DISCOVERY_READY := .venv/ready-bench-discovery
PIP := $(BIN)/python -m pip install --quiet --disable-pip-version-check --constraint constraints.txt

.PHONY: demo test bench bench-discovery clean

demo: $(READY)
	$(BIN)/masking run examples/duffing.yaml --out results/duffing

test: $(READY)
	$(BIN)/ruff format --check .
	$(BIN)/ruff check .
	$(BIN)/mypy
	$(BIN)/pytest -n 2

bench: $(BENCH_READY)
	$(BIN)/python -m tests.benchmarks

bench-discovery: $(DISCOVERY_READY)
	$(BIN)/python -m tests.benchmarks.discovering $(OPTIONS)

$(READY): pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
		{ echo "masking needs Python 3.11 or newer; name one with 'make PYTHON=python3.12'"; exit 1; }
	$(PYTHON) -m venv .venv
	$(PIP) --editable '.[dev]'
	@touch $@

# Contenders that cannot be installed here are left out of the table, which says so.
$(BENCH_READY): $(READY)
	-$(PIP) heyoka
	-$(PIP) numbalsoda
	@touch $@

# Where PySINDy cannot be installed, its columns stay empty and the page says so.
$(DISCOVERY_READY): $(READY)
	-$(PIP) pysindy
	@touch $@

clean:
	rm -rf .venv results .mypy_cache .ruff_cache .hypothesis
