# Two commands do all the set-up on a fresh machine: `make demo` and `make test`.
PYTHON ?= python3
BIN := .venv/bin
SCENE := tests/data/fox
OUT := build/demo

VIEWS := tests/data/fox_views

.PHONY: demo test page clean

# torch is pinned here, in one place; where pip would take its CUDA build, name a CPU index in PIP_EXTRA_INDEX_URL.
.venv/installed: pyproject.toml Makefile
	$(PYTHON) -m venv .venv
	$(BIN)/pip install --quiet torch==2.13.0
	$(BIN)/pip install --quiet --editable '.[train,formats,dev]'
	touch $@

# Tests in a browser are skipped, and say so, where npm, node or chromium is not there.
web/node_modules/installed: web/package-lock.json
	if command -v npm >/dev/null; then npm ci --prefix web --ignore-scripts --no-audit --no-fund && touch $@; fi

# The player, which is committed: whoever installs the package needs no Node.
page: web/node_modules/installed
	npm run --silent --prefix web build

demo: .venv/installed web/node_modules/installed
	mkdir -p $(OUT)
	$(BIN)/airgs-encode $(SCENE) -o $(OUT)/fox.airgs
	$(BIN)/airgs-manifest inspect $(OUT)/fox.airgs --plot $(OUT)/ladder.png
	$(BIN)/airgs-manifest validate $(OUT)/fox.airgs
	$(BIN)/airgs-play $(OUT)/fox.airgs --trace $(SCENE)/trace.csv --views $(SCENE)/transforms.json --report $(OUT)/report --video $(OUT)/screen.mp4
	$(BIN)/airgs-play $(OUT)/fox.airgs --compare --traces $(SCENE)/trace.csv markov:1 --offsets 4 --report $(OUT)/study
	$(BIN)/airgs-train $(VIEWS) -o $(OUT)/trained --iterations 1000,600,150 --resume --report $(OUT)/training
	$(BIN)/airgs-encode $(OUT)/trained -o $(OUT)/trained.airgs
	$(BIN)/airgs-play $(OUT)/trained.airgs --trace $(SCENE)/trace.csv --views $(OUT)/trained/transforms.json --report $(OUT)/trained-report
	-$(BIN)/python -m tools.screenshot $(OUT)/fox.airgs -o $(OUT)/browser.png
	@echo "Pictures: $(OUT)/ladder.png, $(OUT)/report/index.html, $(OUT)/study/index.html, $(OUT)/training/index.html; what the viewer saw: $(OUT)/screen.mp4"
	@echo "In a browser: run $(BIN)/airgs-serve $(OUT) and open http://127.0.0.1:8000/player.html?src=fox.airgs/"

test: .venv/installed web/node_modules/installed
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	@if [ -f web/node_modules/installed ]; then npm run --silent --prefix web check; \
	else echo "types and lint of web/ are not checked: npm is not there"; fi
	$(BIN)/pytest --numprocesses 2 --dist loadfile -rs

clean:
	rm -rf build .venv web/node_modules web/out web/src/generated
