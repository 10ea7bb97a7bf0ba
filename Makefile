# Everything from a fresh clone: `make demo` and `make test` set up .venv themselves (Python >= 3.10, a C++ compiler, make).
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
STAMP := $(VENV)/.installed
BUILD_TOOLS := "scikit-build-core>=1.1" "nanobind>=3.1,<4" "cmeel-eigen>=3.4,<4" "cmake>=3.20" ninja
NATIVE := $(shell find cpp CMakeLists.txt pyproject.toml -type f)

# Most commands of the tests are programs of their own, which start four times as fast where modules stay compiled.
unexport PYTHONDONTWRITEBYTECODE

.PHONY: help env build demo test test-slow lint types rooms mutants sanitize fuzz bench docs page clean
help:
	@echo "make demo | test | test-slow | lint | types | rooms | mutants | sanitize | fuzz | bench | docs | page | clean"

$(VENV)/.tools:
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10) and "Heliograph needs Python 3.10 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install -q --disable-pip-version-check $(BUILD_TOOLS)
	touch $@

$(STAMP): $(VENV)/.tools $(NATIVE)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m pip install -q --disable-pip-version-check --no-build-isolation -e '.[dev]'
	touch $@

env build: $(STAMP)

demo: $(STAMP)
	$(BIN)/heliograph demo --overwrite

test: $(STAMP)
	$(BIN)/python -m pytest -n 2

test-slow: $(STAMP)
	$(BIN)/python -m pytest -n 2 -m slow

lint: $(STAMP)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .

types: $(STAMP)
	$(BIN)/mypy

mutants: $(STAMP)
	PATH="$(abspath $(BIN)):$$PATH" $(BIN)/python -m tests.mutants

rooms: $(STAMP)
	$(BIN)/python -m tests.rooms

sanitize: $(VENV)/.tools
	PATH="$(abspath $(BIN)):$$PATH" cmake -S . -B build/sanitize -G Ninja -DCMAKE_BUILD_TYPE=Debug -DHELIOGRAPH_PYTHON=OFF \
	  -DHELIOGRAPH_CHECKS=ON -DPython_EXECUTABLE=$(abspath $(BIN))/python \
	  -DCMAKE_CXX_FLAGS="-O1 -g -fsanitize=address,undefined -fno-sanitize-recover=all -fno-omit-frame-pointer" >/dev/null
	PATH="$(abspath $(BIN)):$$PATH" cmake --build build/sanitize
	./build/sanitize/heliograph_checks

# Files of every kind, spoilt and read, each in a child with limits: for so long, or so many cases where CASES is given.
SECONDS ?= 120
SEED ?= 1
fuzz: $(STAMP)
	PYTHONPATH=tests:. $(BIN)/python -m tests.fuzz --seed $(SEED) $(if $(CASES),--cases $(CASES) --seconds 0,--seconds $(SECONDS))

# The documentation as a site, in build/site/html; a link that leads nowhere is an error.
docs: $(STAMP)
	$(BIN)/python -m pip install -q --disable-pip-version-check "mkdocs-material>=9.5" "mkdocstrings[python]>=0.26"
	$(BIN)/python docs/site/stage.py build/site/pages
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q --strict -f build/site/mkdocs.yml

# The pages' scripts, linted and type-checked; needs npm, and only this does.
PAGE := build/page
page:
	mkdir -p $(PAGE)/src
	cp .ci/page/package.json .ci/page/eslint.config.mjs $(PAGE)/
	cp src/heliograph/lab/page/*.js src/heliograph/report/*.js .ci/page/globals.d.ts $(PAGE)/src/
	cd $(PAGE) && npm install --silent --no-audit --no-fund
	cd $(PAGE) && node_modules/.bin/eslint src
	cd $(PAGE) && node_modules/.bin/tsc --noEmit --allowJs --checkJs --strict --target es2022 --module es2022 \
	  --moduleResolution bundler --lib es2022,dom,dom.iterable src/globals.d.ts src/*.js

# Rivals pin what Heliograph does not, so they live in an environment of their own.
RIVALS := build/bench-venv
$(RIVALS)/.installed: benchmarks/rivals.txt
	$(PYTHON) -m venv $(RIVALS)
	$(RIVALS)/bin/python -m pip install -q --disable-pip-version-check -r $<
	touch $@

# Ceres comes from the distribution (Debian: libceres-dev); without it the benchmarks leave it out.
CERES := $(if $(wildcard /usr/include/ceres/ceres.h),build/ceres_pose_graph)
build/ceres_pose_graph: benchmarks/ceres/pose_graph.cpp
	mkdir -p build
	$(CXX) -std=c++17 -O3 -DNDEBUG -isystem /usr/include/eigen3 $< -o $@ -lceres -lglog

bench: $(STAMP) $(RIVALS)/.installed $(CERES)
	$(BIN)/python -m benchmarks all

clean:
	rm -rf build $(VENV)
