# SPDX-License-Identifier: GPL-3.0-or-later
# `make demo` and `make test` do all the set-up on a machine that has Python 3.11 or 3.13.

# The Python to make .venv with; empty: 3.11 if it runs here, else 3.13. What .venv was made with it keeps.
SYSTEM_PYTHON ?=
PYTHON := .venv/bin/python
# Workers for the tests; kernels compile once, so a first worker warms the cache for the others.
JOBS ?= auto
BENCH_SCENES ?= builtin:fail-dark-bright
BENCH_RIVALS ?= cycles cycles-guided OFF AUTO VMM NEURAL_RIS
BENCH_OUT ?= out/bench

.DEFAULT_GOAL := help
.PHONY: help demo test slow test-3.13 lint bench gallery kernels extension site clean

help: ## Show what there is
	@grep -E '^[a-z0-9.-]+:.*##' $(MAKEFILE_LIST) | sed -E 's/:[^#]*## /\t/' | expand -t 12

.venv/installed: requirements-3.11.lock requirements-3.13.lock
	@BASE_PYTHON="$(SYSTEM_PYTHON)" tools/make_environment.sh .venv 3.11 3.13

# An environment beside .venv for one version of Python: what the tests need to try the extension in every Blender.
.venv-%/installed: requirements-%.lock
	@BASE_PYTHON= tools/make_environment.sh .venv-$* $*

demo: .venv/installed ## Render the demo scene into out/
	$(PYTHON) -m demo

test: .venv/installed ## Run the tests, but for the slow ones
	$(PYTHON) -m pytest -n $(JOBS) --dist worksteal -m "not slow"

slow: .venv/installed ## Run the slow tests: every scene beside Cycles, fresh installations
	$(PYTHON) -m pytest -n $(JOBS) --dist loadscope -m slow

# What depends on Python or on Blender is tested there: the add-on with its sessions, renders and processes, and nodes
# beside Cycles. Training is not: see requirements-3.13.lock. Nor is Debian's Blender, which is a program of its own, nor
# are the benchmarks, which measure on 3.11, nor the zips, which are built for both ranges there. Nor is, once more,
# whether kernels, scenes' arrays and the estimator are right, or what is learned and tried: kernels are those of 3.11,
# compiled by the same numba and LLVM. That they compile and work there is seen by sessions and by Blender's renders
# beside Cycles, guided ones among them.
ON_311 := $(filter-out %_cycles.py %/test_camera.py,$(wildcard tests/engine/kernels/test_*.py tests/engine/builder/test_*.py)) \
	$(wildcard tests/engine/render/test_trial_*.py tests/addon/test_extension*.py) tests/addon/test_blender34.py \
	tests/benchmarks tests/engine/guiding tests/engine/render/test_adaptive.py tests/engine/render/test_bridge.py \
	tests/engine/render/test_thread_memory.py tests/engine/runtime/test_stage_table.py tests/engine/wavefront \
	tests/tools/test_install_legacy.py
test-3.13: .venv-3.13/installed ## Run the tests on Python 3.13, but for the slow ones
	.venv-3.13/bin/python -m pytest -n $(JOBS) --dist worksteal -m "not slow and not estimator" \
		$(addprefix --ignore ,$(ON_311))

lint: .venv/installed ## Run the linters
	.venv/bin/ruff check .
	.venv/bin/mypy
	.venv/bin/lint-imports --no-cache
	$(PYTHON) -m tools.code_sizes
	$(PYTHON) -m tools.page_names

bench: .venv/installed ## Speed against accuracy beside Cycles, on a page of charts (a quarter hour)
	$(PYTHON) -m benchmarks reference $(BENCH_SCENES) --rival VMM --samples 64 --seeds 4 --pixels 36864 \
		--out $(BENCH_OUT)/references
	$(PYTHON) -m benchmarks sweep $(BENCH_SCENES) --rivals $(BENCH_RIVALS) --seconds 2 6 24 --seeds 3 \
		--references $(BENCH_OUT)/references --out $(BENCH_OUT)/sweep
	$(PYTHON) -m benchmarks report $(BENCH_OUT)/sweep --references $(BENCH_OUT)/references --to $(BENCH_OUT)/report

gallery: .venv/installed ## Contact sheet: ours, Cycles', difference
	$(PYTHON) -m benchmarks gallery

kernels: .venv/installed ## Compile all kernels ahead, for this checkout (minutes; on Linux)
	$(PYTHON) tools/kernel_library.py

# With .venv-3.13 (`make .venv-3.13/installed`), kernels are compiled ahead for Blender 5.1 and later too. Without any:
# `.venv/bin/python tools/build_extension.py --quick`.
extension: .venv/installed ## Build the zips for Blender into dist/, kernels for Linux included (minutes; it says how long)
	$(PYTHON) tools/build_extension.py

# An environment of its own: the site's packages are no part of the project.
.venv-site/installed: requirements-site.lock
	$$(tools/find_python.sh 3.11 3.13) -m venv .venv-site
	.venv-site/bin/python -m pip install --disable-pip-version-check --quiet -r requirements-site.lock
	touch $@

site: .venv-site/installed ## Build the pages of docs/ as a site into out/site; broken links fail
	# Not quiet: warnings that are not said do not fail.
	NO_MKDOCS_2_WARNING=1 .venv-site/bin/mkdocs build --strict

clean: ## Remove what was built
	rm -rf build dist out engine/compiled .pytest_cache .mypy_cache .ruff_cache
