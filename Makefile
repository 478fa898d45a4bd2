# SPDX-License-Identifier: GPL-3.0-or-later
# `make demo` and `make test` do all the set-up on a machine that has Python 3.11.

SYSTEM_PYTHON ?= python3.11
PYTHON := .venv/bin/python
# Workers for the tests; kernels compile once, so a first worker warms the cache for the others.
JOBS ?= auto
BENCH_SCENES ?= builtin:evening-room
BENCH_RIVALS ?= cycles cycles-guided OFF VMM TABLE_RIS
BENCH_OUT ?= out/bench

.DEFAULT_GOAL := help
.PHONY: help demo test slow lint bench gallery extension clean

help: ## Show what there is
	@grep -E '^[a-z]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

.venv/installed: requirements.lock
	$(SYSTEM_PYTHON) -m venv .venv
	$(PYTHON) -m pip install --disable-pip-version-check --quiet -r requirements.lock
	@touch $@

demo: .venv/installed ## Render the demo scene into out/
	$(PYTHON) -m demo

test: .venv/installed ## Run the tests, but for the slow ones
	$(PYTHON) -m pytest -n $(JOBS) -m "not slow"

slow: .venv/installed ## Run the slow tests: every scene beside Cycles, fresh installations
	$(PYTHON) -m pytest -n $(JOBS) -m slow

lint: .venv/installed ## Run the linters
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports --no-cache

bench: .venv/installed ## Speed against accuracy beside Cycles, on a page of charts (ten minutes)
	$(PYTHON) -m benchmarks reference $(BENCH_SCENES) --rival VMM --samples 64 --seeds 4 --pixels 36864 \
		--out $(BENCH_OUT)/references
	$(PYTHON) -m benchmarks sweep $(BENCH_SCENES) --rivals $(BENCH_RIVALS) --seconds 2 4 8 --seeds 3 \
		--references $(BENCH_OUT)/references --out $(BENCH_OUT)/sweep
	$(PYTHON) -m benchmarks report $(BENCH_OUT)/sweep --references $(BENCH_OUT)/references --to $(BENCH_OUT)/report

gallery: .venv/installed ## Contact sheet: ours, Cycles', difference
	$(PYTHON) -m benchmarks gallery

extension: .venv/installed ## Build the Blender extension into dist/
	$(PYTHON) tools/build_extension.py

clean: ## Remove what was built
	rm -rf build dist out .pytest_cache .mypy_cache .ruff_cache
