# Two commands do all the set-up on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
SCENE := tests/data/fox
OUT := build/demo

VIEWS := tests/data/fox_views

.PHONY: demo test clean

# torch is pinned here, in one place; where pip would take its CUDA build, name a CPU index in PIP_EXTRA_INDEX_URL.
.venv/installed: pyproject.toml Makefile
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet torch==2.13.0
	$(BIN)/pip install --quiet --editable '.[train,dev]'
	touch $@

# Tests in a browser are skipped, and say so, where npm, node or chromium is not there.
web/node_modules/installed: web/package-lock.json
	if command -v npm >/dev/null; then npm ci --prefix web --ignore-scripts --no-audit --no-fund && touch $@; fi

demo: .venv/installed
	mkdir -p $(OUT)
	$(BIN)/airgs-encode $(SCENE) -o $(OUT)/fox.airgs
	$(BIN)/airgs-manifest inspect $(OUT)/fox.airgs --plot $(OUT)/ladder.png
	$(BIN)/airgs-manifest validate $(OUT)/fox.airgs
	$(BIN)/airgs-play $(OUT)/fox.airgs --trace $(SCENE)/trace.csv --views $(SCENE)/transforms.json --report $(OUT)/report --video $(OUT)/screen.mp4
	$(BIN)/airgs-play $(OUT)/fox.airgs --compare --traces $(SCENE)/trace.csv markov:1 --offsets 4 --report $(OUT)/study
	$(BIN)/airgs-train $(VIEWS) -o $(OUT)/trained --iterations 1000,600,150 --resume --report $(OUT)/training
	$(BIN)/airgs-encode $(OUT)/trained -o $(OUT)/trained.airgs
	$(BIN)/airgs-play $(OUT)/trained.airgs --trace $(SCENE)/trace.csv --views $(OUT)/trained/transforms.json --report $(OUT)/trained-report
	@echo "Pictures: $(OUT)/ladder.png, $(OUT)/report/index.html, $(OUT)/study/index.html, $(OUT)/training/index.html; what the viewer saw: $(OUT)/screen.mp4"

test: .venv/installed web/node_modules/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/pytest --numprocesses 2 --dist loadfile -rs

clean:
	rm -rf build .venv web/node_modules
