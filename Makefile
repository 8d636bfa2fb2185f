# make run    install into .venv and run the paper's procedure on the emulated bench
# make investigate  identify a hidden effect on the emulated bench, and verify its compensation
# make test   install into .venv and run the test suite, but for what takes long
# make test-long  whole campaigns, statistics of many samples, kills, fuzzing
# make soak   kill, disturb and keep runs running for an hour; writes docs/reliability.md
# make check  style, types, layers
# make docs   pages of docs/ as HTML, in build/docs
# make audit  known vulnerabilities of the dependencies (needs the network)
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin

# The matrices are small: threads of the linear algebra only get into each other's way.
export OPENBLAS_NUM_THREADS ?= 1
# Hundreds of processes would each compile what they import, and each worker all tests.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: run investigate test test-long soak check docs audit benchmark install clean

run: $(VENV)/.installed
	$(BIN)/gyrobench run procedures/six_position_fig7.yaml
	$(BIN)/gyrobench close "$$(ls -td runs/six_position_fig7-* | head -n 1)"

investigate: $(VENV)/.installed
	$(BIN)/gyrobench investigate quick_campaign --station quick --world quick_warm_up --approve auto \
		--verification quick_verification

# Four workers on two cores: two run the tests that wait in real time.
test: install
	$(BIN)/python -m pytest -m "not long" -p no:benchmark -n 4 --dist loadfile --no-loadscope-reorder

# With many more examples of those that hypothesis makes up.
test-long: install
	$(BIN)/python -m pytest -m "long or hypothesis" -p no:benchmark --hypothesis-profile=thorough -n 4 --dist loadfile --no-loadscope-reorder

soak: install
	$(BIN)/python -m tests.soak all --table docs/reliability.md

check: install
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: install
	$(BIN)/python docs/make_reference.py
	$(BIN)/python -m sphinx -q -W --keep-going -n -b html docs build/docs

# Known vulnerabilities of the pinned versions; asks the network, and installs pip-audit for itself.
audit: install
	$(BIN)/python -m pip check
	$(PYTHON) -m venv $(VENV)/audit
	$(VENV)/audit/bin/python -m pip install --quiet pip-audit
	$(VENV)/audit/bin/python -m pip_audit --requirement constraints.txt --no-deps --disable-pip

benchmark: install
	$(BIN)/python -m pytest tests/benchmarks -o python_files="bench_*.py" -o timeout=900 -s -q

$(VENV)/.installed: pyproject.toml constraints.txt
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --upgrade pip
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable .
	$(BIN)/gyrobench schema --out schemas
	touch $@

# What developing needs beside what running needs.
install: $(VENV)/.installed-dev

$(VENV)/.installed-dev: $(VENV)/.installed
	$(BIN)/python -m pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

clean:
	rm -rf $(VENV) build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis
