# Two commands do all the set-up: `make demo` (no torch) and `make test` (everything).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
OUT := demo-output
PIP := $(BIN)/pip install --quiet --constraint constraints.txt

.PHONY: demo test lint bench tables clean

$(BIN)/pip:
	$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "page-edge needs Python 3.11 or newer; set PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)

$(VENV)/.runtime: pyproject.toml constraints.txt | $(BIN)/pip
	$(PIP) --editable .
	touch $@

$(VENV)/.dev: pyproject.toml constraints.txt | $(BIN)/pip
	$(PIP) --editable '.[dev]'
	touch $@ $(VENV)/.runtime

demo: $(VENV)/.runtime
	@mkdir -p $(OUT)
	@for category in laptop box; do \
		echo; echo "== $$category =="; \
		$(BIN)/page-runtime run tests/data/$$category --bundle runtime/bundles/$$category.onnx \
			--out $(OUT)/$$category.jsonl --overlay $(OUT)/$$category --quiet || exit $$?; \
		$(BIN)/page-runtime validate tests/data/$$category --bundle runtime/bundles/$$category.onnx \
			--json $(OUT)/$$category-validate.json --quiet || exit $$?; \
		$(BIN)/page-runtime bench tests/data/$$category --bundle runtime/bundles/$$category.onnx \
			--json $(OUT)/$$category-bench.json --quiet || exit $$?; \
	done
	@echo; echo "Poses: $(OUT)/laptop.jsonl $(OUT)/box.jsonl"; echo "Pictures:"; ls $(OUT)/laptop/* $(OUT)/box/*

# One process a core, each with one thread: with more they wait for each other.
test: $(VENV)/.dev
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(BIN)/python -m pytest --numprocesses auto --maxprocesses 4 --dist loadfile

lint: $(VENV)/.dev
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/pyright

bench: $(VENV)/.runtime
	@mkdir -p $(OUT)
	$(BIN)/page-runtime bench tests/data/laptop --bundle runtime/bundles/laptop.onnx --looks 1 --json $(OUT)/laptop-latency.json

# Hours on two cores where nothing is kept yet; interrupt it, and the same command goes on.
tables: $(VENV)/.dev
	$(BIN)/python benchmarks/paper_tables.py --readme

clean:
	rm -rf $(VENV) $(OUT)
