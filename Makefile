# `make demo` and `make test` do all the set-up on a fresh machine.
PYTHON ?= python3
BIN := .venv/bin
FOX := tests/data/fox
OUT := build/demo
HEAD := manifests/showcase/head.airgs
TALK := manifests/showcase/talk

VIEWS := tests/data/fox_views

# Else every process of a test run compiles what it imports.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: demo demo-train demo-study lock test lint web-check pytest soak mutants gpu page clean

# Where pip would take torch's CUDA build, name a CPU index in PIP_EXTRA_INDEX_URL.
.venv/installed: pyproject.toml constraints.txt Makefile
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[dev]'
	touch $@

# The newest versions of all dependencies, for `make test` to try before they are committed.
lock:
	$(PYTHON) -m venv --clear build/lock
	build/lock/bin/pip install --quiet --editable '.[dev]'
	build/lock/bin/pip freeze --all --exclude airgs-codec --exclude pip | sed 's/+.*//' | LC_ALL=C sort -f > constraints.txt

# Tests in a browser are skipped, and say so, where npm, node or chromium is not there.
web/node_modules/installed: web/package-lock.json
	if command -v npm >/dev/null; then npm ci --prefix web --ignore-scripts --no-audit --no-fund && touch $@; fi

# The player, which is committed: whoever installs the package needs no Node.
page: web/node_modules/installed
	npm run --silent --prefix web build

demo: .venv/installed web/node_modules/installed
	mkdir -p $(OUT)
	-$(BIN)/python -m tools.screenshot $(HEAD) -o $(OUT)/head.png
	@echo "A picture of it playing: $(OUT)/head.png. To watch it: $(BIN)/airgs-serve $(HEAD) --open"
	@echo
	$(BIN)/airgs-encode $(TALK) -o $(OUT)/talk.airgs
	$(BIN)/airgs-manifest inspect $(OUT)/talk.airgs --plot $(OUT)/ladder.png
	$(BIN)/airgs-manifest validate $(OUT)/talk.airgs
	$(BIN)/airgs-play $(OUT)/talk.airgs --trace $(FOX)/trace.csv --report $(OUT)/report
	@echo
	@echo "Pictures: $(OUT)/ladder.png, $(OUT)/report/index.html. What to do next:"
	@echo "  $(BIN)/airgs-serve $(OUT)/talk.airgs --open    # play it in a browser"
	@echo "  make demo-study                              # compare policies over networks"
	@echo "  make demo-train                              # train a scene from pictures, then encode it"

demo-train: .venv/installed
	$(BIN)/airgs-train $(VIEWS) -o $(OUT)/trained --iterations 1000,600,150 --resume --report $(OUT)/training
	$(BIN)/airgs-encode $(OUT)/trained -o $(OUT)/trained.airgs
	$(BIN)/airgs-play $(OUT)/trained.airgs --trace $(FOX)/trace.csv --report $(OUT)/trained-report
	@echo "Pictures: $(OUT)/training/index.html, $(OUT)/trained-report/index.html"

demo-study: .venv/installed
	test -d $(OUT)/fox.airgs || $(BIN)/airgs-encode $(FOX) -o $(OUT)/fox.airgs
	$(BIN)/airgs-play $(OUT)/fox.airgs --compare --traces $(FOX)/trace.csv markov:1 --offsets 4

# Lint and types take one core while tests take the other.
test: .venv/installed web/node_modules/installed
	@$(MAKE) --no-print-directory --jobs 2 lint web-check pytest

lint: .venv/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy

web-check: web/node_modules/installed
	@if [ -f web/node_modules/installed ]; then npm run --silent --prefix web check; \
	else echo "types and lint of web/ are not checked: npm is not there"; fi

pytest: .venv/installed
	$(BIN)/pytest --numprocesses 4 --dist loadfile -rs

# What takes long: mutated files, killed encodes and trainings, full disks, a farm that fails, browsers that play on and
# on. Hours in all.
soak: .venv/installed
	$(BIN)/python -m tests.long

# Changes rules that decide, one operator or constant at a time, and runs their tests: survivors are what no test asks.
# About an hour.
mutants: .venv/installed
	$(BIN)/pip install --quiet mutmut==3.8.1
	NUMBA_THREADING_LAYER=forksafe $(BIN)/mutmut run
	$(BIN)/mutmut results

# For a machine with an NVIDIA GPU: its driver, and nvcc and a C++ compiler, since gsplat comes from PyPI as source and
# is compiled once, for minutes, before anything is timed. PyPI's torch 2.13 is for CUDA 13, and so must the toolkit be
# (on the PATH, or at CUDA_HOME); ninja comes with gsplat, and torch looks for it on the PATH.
.venv/gpu: .venv/installed
	$(BIN)/pip install --quiet --constraint constraints.txt --editable '.[cuda]'
	PATH="$(CURDIR)/$(BIN):$$PATH" $(BIN)/python -c "import sys; from airgs_codec.render.cuda import missing; sys.exit(missing())"
	-$(BIN)/pytest tests/render/test_cuda.py  # compiles the CPU's kernels
	touch $@

# Nine minutes in all: one for the tests of gsplat, eight for fits, encodes and what must be equal; the table of all is
# build/lab/gpu/gpu.md. `make gpu SCENE=DIR` takes a scene of your own besides the fox.
gpu: export PATH := $(CURDIR)/$(BIN):$(PATH)
gpu: .venv/gpu
	-timeout 60 $(BIN)/pytest -rs tests/render/test_cuda.py
	$(BIN)/python -m tools.check_gpu $(VIEWS) $(SCENE)

clean:
	rm -rf build mutants .venv web/node_modules web/out
