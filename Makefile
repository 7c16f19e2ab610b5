# Two commands are enough on a fresh machine: `make demo` and `make test`.
# They need Python >= 3.10 and make; everything else goes into the virtual environment .venv.

PYTHON ?= python3
VENV   ?= .venv
BIN    := $(VENV)/bin
PIP    := $(BIN)/python -m pip --disable-pip-version-check --quiet
OUT    := out

.DEFAULT_GOAL := help
.PHONY: help demo test test-all check docs blender lock clean

help:  ## list what there is to make
	@grep -hE '^[a-z-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:.*## /\t/' | expand -t 10

demo: $(VENV)/.base  ## clean the example render; writes pictures and a report to out/
	@mkdir -p $(OUT)
	$(BIN)/lambent denoise examples/still_life/noisy.exr -o $(OUT)/clean.exr \
	    --report --preview --overwrite
	$(BIN)/lambent compare examples/still_life/reference.exr \
	    examples/still_life/noisy.exr $(OUT)/clean.exr --report $(OUT)/compare.html
	@echo "Look at $(OUT)/clean_preview.png, and open $(OUT)/clean.html and $(OUT)/compare.html."

test: $(VENV)/.test  ## run the tests that need no PyTorch, Ray or browser
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow and not heavy"

test-all: test $(VENV)/.dev  ## run those, then the others (installs 6 GB more, most of it CUDA)
	$(BIN)/python -m pytest -n 2 --dist loadfile -m "not slow and heavy"

check: $(VENV)/.dev  ## format, lint, types, import contract
	$(BIN)/ruff format --check src tests benchmarks docs examples
	$(BIN)/ruff check src tests benchmarks docs examples
	$(BIN)/mypy
	$(BIN)/lint-imports

docs: $(VENV)/.dev  ## build the documentation to docs/_build/html, warnings are errors
	$(BIN)/sphinx-build -q -W --keep-going -b html docs docs/_build/html
	@echo "open docs/_build/html/index.html"

blender: $(VENV)-blender/.done  ## an environment with Blender for the tests (Python 3.11 only)
	@echo "export LAMBENT_BLENDER=$$PWD/$(VENV)-blender/bin/python"

lock:  ## renew the lock files (names, versions, hashes)
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-header --no-annotate \
	    --quiet pyproject.toml --extra test-all --extra docs --extra check \
	    -o requirements/dev.lock
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-header --no-annotate \
	    --quiet pyproject.toml --extra test -c requirements/dev.lock -o requirements/test.lock
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-header --no-annotate \
	    --quiet pyproject.toml -c requirements/dev.lock -o requirements/base.lock
	echo 'bpy>=5.0' | uv pip compile --python-version 3.11 --generate-hashes --no-header --no-annotate \
	    --quiet - -o requirements/blender.lock

clean:  ## remove what make made
	rm -rf $(VENV) $(VENV)-blender $(OUT) docs/_build docs/_generated

# ---------------------------------------------------------------- environments

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 10))' || \
	    { echo "Lambent needs Python 3.10 or newer; this is $$($(PYTHON) --version). \
	Try: make PYTHON=python3.12 $(MAKECMDGOALS)"; exit 1; }
	$(PYTHON) -m venv $(VENV)

$(VENV)/.base: $(VENV)/bin/python requirements/base.lock pyproject.toml
	$(PIP) install --require-hashes -r requirements/base.lock
	$(PIP) install --no-deps -e .
	@touch $@

$(VENV)/.test: $(VENV)/.base requirements/test.lock
	$(PIP) install --require-hashes -r requirements/test.lock
	@touch $@

$(VENV)/.dev: $(VENV)/.test requirements/dev.lock
	$(PIP) install --require-hashes -r requirements/dev.lock
	@touch $@

# Blender's wheel wants an older NumPy than ours, so it has an environment of its own.
$(VENV)-blender/.done: requirements/blender.lock
	$(PYTHON) -m venv $(VENV)-blender
	$(VENV)-blender/bin/python -m pip --disable-pip-version-check --quiet install \
	    --require-hashes -r requirements/blender.lock
	@touch $@
