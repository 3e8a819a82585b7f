# Everything lands in .venv; nothing is installed outside this folder.

BIN := .venv/bin
READY := .venv/seft-ready
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
PACKAGES := src/seft_msgs_py src/seft_plant_sim src/seft_ros
DOCS = $(BIN)/sphinx-build -q -W --keep-going -c docs . build/docs
BUILD_FILES := $(wildcard $(foreach p,$(PACKAGES),$(p)/setup.py $(p)/setup.cfg $(p)/pyproject.toml))

# .venv brings its own ROS: one sourced in this shell must not shine through.
unexport AMENT_PREFIX_PATH PYTHONHOME PYTHONPATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
ifdef ROS_DISTRO
unexport LD_LIBRARY_PATH
endif

# Ready is an environment that was finished, in this very folder, and whose Python still runs.
HEALTHY := $(shell [ "$$(cat $(READY) 2>/dev/null)" = "$$(pwd -P)" ] && [ -x $(BIN)/seft ] \
	&& $(BIN)/python -I -S -c '' 2>/dev/null && echo yes)

.PHONY: help setup demo test docs thorough bench clean unfinished
.DELETE_ON_ERROR:

help: ## this list
	@awk -F ':.*## ' '/^[a-z]+:.*## / {printf "  make %-8s %s\n", $$1, $$2}' Makefile

setup: $(READY) ## make .venv with the pinned libraries and the three packages
	@:

demo: $(READY) ## the test of config/demo.yaml over ROS 2, on the simulated rig
	$(BIN)/seft run config/demo.yaml

test: $(READY) ## all checks: lint, format, types, docs, tests (CI runs the same)
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/mypy
	$(DOCS)
	$(BIN)/pytest src -n 2 --durations 10
	$(BIN)/pytest tests -n 2 -m "not thorough and not alone" --durations 15
	$(BIN)/pytest tests -m "alone and not thorough"

docs: $(READY) ## the pages as HTML in build/docs, every link between them checked
	$(DOCS)

thorough: $(READY) ## the tests that take long: the tutorial, every fault in every state
	$(BIN)/pytest src tests -m thorough

bench: $(READY) ## every benchmark in bench, one after another
	@failed=; for file in $(sort $(wildcard bench/[!_]*.py)); do \
		echo "== $$file"; $(BIN)/python "$$file" || failed="$$failed $$file"; \
	done; [ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

clean: ## remove .venv, caches and what colcon built (recorded bags stay)
	rm -rf $(READY) .venv build install log
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache $(PACKAGES:%=%/build) src/*/*.egg-info
	find . -name .git -prune -o -name __pycache__ -prune -exec rm -rf {} +

ifneq ($(HEALTHY),yes)
$(READY): unfinished
endif

$(READY): requirements.txt $(BUILD_FILES)
ifneq ($(HEALTHY),yes)
	@python=$$(sh tools/find_python.sh) || exit 2; \
	echo "seft: making .venv with $$python"; \
	rm -rf .venv && "$$python" -m venv .venv
endif
	@rm -f $(READY)
	@echo "seft: installing the pinned libraries (at first some 500 MB, a few minutes)"
	@$(PIP) install -r requirements.txt || { \
		echo "seft: see why with: $(BIN)/pip install -r requirements.txt" >&2; exit 2; }
	@echo "seft: installing the three packages in place"
	@$(PIP) install --no-deps --no-build-isolation $(PACKAGES:%=-e %)
	@pwd -P > $(READY)
	@echo "seft: .venv is ready"
