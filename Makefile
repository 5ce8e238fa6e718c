# make demo, make test: each sets up .venv first. Nothing else needs to be installed but Python >= 3.11 with venv.
PYTHON ?= python3
VENV := .venv
CONTROLLER := build/controller
SETUP := $(VENV)/.set-up

.PHONY: demo test check test-controller bench diagnosis-check diagnosis-check-short registers lock clean

demo: $(SETUP)
	$(VENV)/bin/trueangle demo --out build/demo

# Two BLAS threads on a shared core wait for one another: one is faster.
test: check
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest

check: $(SETUP)
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/ruff check .
	$(VENV)/bin/basedpyright
	$(VENV)/bin/lint-imports

$(SETUP): requirements-dev.lock pyproject.toml
	@echo "setting up $(VENV): downloads and unpacks about 5 GB (torch), some minutes the first time"
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install --disable-pip-version-check --require-hashes -r requirements-dev.lock
	$(VENV)/bin/pip install --disable-pip-version-check -q --no-build-isolation --no-deps -e .
	touch $@

# The daemon as a controller has it: the wheel without the extra, its tests without torch.
test-controller:
	rm -rf $(CONTROLLER)
	$(PYTHON) -m venv $(CONTROLLER)
	$(CONTROLLER)/bin/pip install --disable-pip-version-check -q --require-hashes -r requirements-controller-test.lock
	$(CONTROLLER)/bin/pip install --disable-pip-version-check -q --no-build-isolation --no-deps .
	$(CONTROLLER)/bin/python -m pytest -o pythonpath=. tests/contract tests/daemon

bench: $(SETUP)
	$(VENV)/bin/python -m tests.benchmarks

# Sealed cases of all plants, scored against section 6 of the diagnosis' targets: about two hours on two cores.
# Each look is written down; a call that was cut off is gone on with.
diagnosis-check: $(SETUP)
	$(VENV)/bin/trueangle blind-check -o build/diagnosis-check --log tests/data/blind_looks.jsonl

# What must not get worse, on the plant that the diagnosis is developed on: the others stay blind.
# To renew the figures after a change for the better: the same call with --log in place of --no-worse-than.
SHORT_CHECK = --cases 36 --seed 1 --plant A --plan paper --no-reports
diagnosis-check-short: $(SETUP)
	rm -rf build/diagnosis-check-short
	$(VENV)/bin/trueangle blind-check -o build/diagnosis-check-short $(SHORT_CHECK) \
		--no-worse-than tests/data/blind_short.jsonl

registers: $(SETUP)
	$(VENV)/bin/trueangled registers --format markdown > deploy/registers.md
	$(VENV)/bin/trueangled registers --format csv > deploy/registers.csv
	$(VENV)/bin/trueangled metrics > deploy/metrics.md

# Needs uv; the locks carry hashes and no index address.
UV_LOCK = uv pip compile -q pyproject.toml --universal --python-version 3.11 --generate-hashes \
	--no-emit-index-url --no-header --no-annotate
lock:
	$(UV_LOCK) --extra training --group build --group test --group lint -o requirements-dev.lock
	$(UV_LOCK) --group build --group test -c requirements-dev.lock -o requirements-controller-test.lock
	$(UV_LOCK) -c requirements-dev.lock -o requirements.lock

clean:
	rm -rf $(VENV) build dist

# A million random and mutated inputs: minutes. The short form is part of `make test`.
.PHONY: fuzz
fuzz: $(SETUP)
	$(VENV)/bin/python -m tests.fuzz

# Modbus clients of other makers as readers; installs what they need under build/peers, from lock files with hashes.
.PHONY: peers
peers: $(SETUP)
	mkdir -p build
	cp -r tests/peers build/
	command -v npm > /dev/null && for peer in jsmodbus modbus_serial; do \
		(cd build/peers/$$peer && npm ci --ignore-scripts --no-audit --no-fund) || exit 1; done || true
	command -v mvn > /dev/null && (cd build/peers/j2mod && \
		mvn -q -B compile dependency:copy-dependencies -DoutputDirectory=target/lib) || true
	$(VENV)/bin/python -m pytest -rs tests/system/test_peers.py

# An hour of mixed load: SOAK_S=600 make soak takes ten minutes. Exit status 1: memory or descriptors rise.
.PHONY: soak
soak: $(SETUP)
	$(VENV)/bin/python -m tests.soak
