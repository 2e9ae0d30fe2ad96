# One command sets up and runs the main job (make demo), one sets up and passes the tests (make test).
# Needs only Python >= 3.11 and make.
PYTHON ?= python3
VENV   := .venv
# Windows keeps a virtual environment's programs elsewhere.
BIN    := $(VENV)/$(if $(filter Windows_NT,$(OS)),Scripts,bin)
PY     := $(BIN)/python
STAMP  := $(VENV)/.installed
BYTECODE := "import compileall, sysconfig; compileall.compile_dir(sysconfig.get_path('purelib'), quiet=2, workers=0)"
# By another name, so that `make -n test` runs nothing.
SUBMAKE := $(MAKE) --no-print-directory

.PHONY: setup demo test test-slow test-browser fuzz docs lint lock bench clean

setup: $(STAMP)

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(0 if sys.version_info >= (3, 11) else "Python 3.11 or newer is needed, this is " + sys.version.split()[0] + "; run: make setup PYTHON=python3.11")'
	$(PYTHON) -m venv $(VENV)
	$(PY) -m pip install --quiet --disable-pip-version-check --no-compile -r requirements.lock
	$(PY) -m pip install --quiet --disable-pip-version-check --no-deps -e .
	@# pip would write the bytecode with one core.
	$(PY) -c $(BYTECODE) & bytecode=$$!; $(PY) -m sysid.effects.compile_loops; loops=$$?; \
	wait $$bytecode; [ $$loops -eq 0 ]
	@touch $(STAMP)

demo: setup
	$(BIN)/uqharness study campaigns/chain/chain.toml --out campaigns/chain/results

lint: setup
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

# The linter and the type checker run beside the tests: their output comes last, and each can fail
# the target. The tests start hundreds of processes, which would compile all modules anew without
# bytecode. tests/conftest.py puts the longest files first.
test: setup
	@log=$$(mktemp); $(SUBMAKE) lint > $$log 2>&1 & lint=$$!; \
	PYTHONDONTWRITEBYTECODE= OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m pytest -n 2 --dist loadfile \
		--no-loadscope-reorder -m "not slow and not browser"; tests=$$?; \
	wait $$lint; lint=$$?; cat $$log; rm -f $$log; \
	[ $$tests -eq 0 ] || echo "tests failed" >&2; [ $$lint -eq 0 ] || echo "lint failed" >&2; \
	[ $$tests -eq 0 ] && [ $$lint -eq 0 ]

test-slow: setup
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m pytest -n 2 --dist loadfile -m slow

# A minute of mutated files of every format; another stretch of inputs: make fuzz SEED=1000000.
fuzz: setup
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m tests.fuzz --seconds 60 --seed $(or $(SEED),0)

docs: setup
	$(PY) docs/site/build.py --out build/docs

# Installs playwright and a Chromium if it can; skips, saying why, if it cannot.
test-browser: setup
	.ci/browser $(PY)
	OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 $(PY) -m pytest -m browser -rs

bench: setup
	@folder=$$(mktemp -d) && trap 'rm -rf "$$folder"' EXIT && \
	$(PY) -m uqharness fly espaaro --script flight-bounds --noise --seed 3 --out "$$folder/flight.parquet" && \
	$(PY) -m uqharness bounds espaaro --flight "$$folder/flight.parquet" --out "$$folder/bounds" --no-check > /dev/null && \
	$(PY) -m uqharness fly espaaro --script flight-ident --noise --seed 3 --out "$$folder/ident.parquet" && \
	OPENBLAS_NUM_THREADS=1 $(PY) -m uqharness.cli.benchmark_batch --model-form "$$folder/bounds/model-form.json" \
		--flight "$$folder/ident.parquet"

lock:
	$(PYTHON) -m piptools compile --no-emit-find-links --quiet --strip-extras --extra dev --output-file requirements.lock pyproject.toml

clean:
	rm -rf $(VENV) campaigns/*/results .pytest_cache .mypy_cache .ruff_cache
