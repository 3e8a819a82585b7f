# Everything lands in .venv (and .venv-ubuntu); nothing is installed outside this folder.

BIN := .venv/bin
READY := .venv/seft-ready
PIP := $(BIN)/python -m pip --disable-pip-version-check -qq
UBUNTU := .venv-ubuntu
UBUNTU_READY := $(UBUNTU)/seft-ready
UBUNTU_PIP := $(UBUNTU)/bin/python -m pip --disable-pip-version-check -qq
PACKAGES := src/seft_msgs_py src/seft_plant_sim src/seft_ros examples/methods
DOCS = $(BIN)/sphinx-build -q -W --keep-going -c docs . build/docs
BUILD_FILES := $(wildcard $(foreach p,$(PACKAGES),$(p)/setup.py $(p)/setup.cfg $(p)/pyproject.toml))

# .venv brings its own ROS: one sourced in this shell must not shine through.
unexport AMENT_PREFIX_PATH PYTHONHOME PYTHONPATH RMW_IMPLEMENTATION _ROS_WHEELS_BOOTSTRAP_COMPLETE
# What Python and pytest make of a file is kept beside it, so that it is made once.
unexport PYTHONDONTWRITEBYTECODE
ifdef ROS_DISTRO
unexport LD_LIBRARY_PATH
endif

# Ready is an environment that was finished, in this very folder, and whose Python still runs.
healthy = $(shell [ "$$(cat $(1)/seft-ready 2>/dev/null)" = "$$(pwd -P)" ] && [ -x $(1)/bin/seft ] \
	&& $(1)/bin/python -I -S -c '' 2>/dev/null && echo yes)
HEALTHY := $(call healthy,.venv)
HEALTHY_UBUNTU := $(call healthy,$(UBUNTU))

# A test that hangs ends, and the others go on; pytest 7, which Ubuntu 24.04 has, does not know this.
PYTEST := $(BIN)/pytest -o faulthandler_exit_on_timeout=true

# $(call step,what it does,command): say so, do it, and say how long it took.
step = @printf 'seft: %s ...\n' "$(1)"; begun=$$(date +%s); $(2) || exit 2; \
	echo "seft: ... $$(($$(date +%s) - begun)) s"

.PHONY: help setup setup-ubuntu demo test test-ubuntu types docs thorough thorough-offline bench \
	clean unfinished
.DELETE_ON_ERROR:

help: ## this list
	@awk -F ':.*## ' '/^[a-z-]+:.*## / {printf "  make %-16s %s\n", $$1, $$2}' Makefile

setup: $(READY) ## make .venv with the pinned libraries, the three packages and examples/methods
	@:

demo: $(READY) ## the test of config/demo.yaml over ROS 2, on the simulated rig
	$(BIN)/seft run config/demo.yaml

test: $(READY) ## lint, format, types, docs and tests: 4 to 7 minutes on two cores
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	@$(MAKE) --no-print-directory -j 2 types docs
	$(PYTEST) -n 2 --dist loadfile --durations 10

# All but what takes long and is arithmetic of our own, which no library changes: steps against
# their formulas. The other tests call the same steps (test_cli_identify the identification).
OWN := by_hand or test_response.py or energy_balance.py or analysis_energy.py \
	or test_metrics or test_protection or test_judge or test_detectors or test_target_motion \
	or test_velocity_feedforward or test_position_servo or test_scaled_rigs or test_force_controller \
	or test_faults or test_springs or test_bouc_wen or test_oil_column or test_identification \
	or test_offline_rigs or test_node_replays or test_design_frozen or test_loop_delay
test-ubuntu: $(UBUNTU_READY) ## the packages' tests with the oldest libraries: Ubuntu 24.04's
	$(UBUNTU)/bin/pytest src examples/methods -n 2 -k "not ($(OWN))"

setup-ubuntu: $(UBUNTU_READY)
	@:

types: $(READY)
	$(BIN)/mypy

docs: $(READY) ## the pages as HTML in build/docs, every link between them checked
	$(DOCS)

thorough: thorough-offline ## all other tests: hosts, browser, colcon, cluster, time; an idle machine
	$(PYTEST) src examples tests -m "thorough and not offline"

thorough-offline: $(READY) ## of these what is arithmetic alone, and what is drawn anew in each run
	$(PYTEST) -n 2 -m "(thorough and offline) or hypothesis" --hypothesis-profile drawn

bench: $(READY) ## every benchmark in bench, one after another
	@failed=; for file in $(sort $(wildcard bench/[!_]*.py)); do \
		echo "== $$file"; $(BIN)/python "$$file" || failed="$$failed $$file"; \
	done; [ -z "$$failed" ] || { echo "failed:$$failed" >&2; exit 1; }

clean: ## remove .venv, .venv-ubuntu, caches and what colcon built (recorded bags stay)
	rm -rf $(READY) .venv $(UBUNTU_READY) $(UBUNTU) build install log
	rm -rf .hypothesis .mypy_cache .pytest_cache .ruff_cache $(PACKAGES:%=%/build) $(PACKAGES:%=%/*.egg-info)
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
	$(call step,installing the pinned libraries (at first some 500 MB, a few minutes), \
		$(PIP) install -r requirements.txt || { \
		echo "seft: see why with: $(BIN)/pip install -r requirements.txt" >&2; false; })
	$(call step,installing the packages in place, \
		$(PIP) install --no-deps --no-build-isolation $(PACKAGES:%=-e %))
	$(call step,compiling the steps of tests of one axis and of several (a minute or two, once), \
		$(BIN)/python -m compileall -q $(PACKAGES); \
		for config in demo jhu three_storey_frame; do \
			($(BIN)/seft simulate config/$$config.yaml; \
				$(BIN)/python tools/compile_loop.py config/$$config.yaml) >/dev/null 2>&1 & \
		done; wait)
	@pwd -P > $(READY)
	@echo "seft: .venv is ready"

ifneq ($(HEALTHY_UBUNTU),yes)
$(UBUNTU_READY): unfinished
endif

# What tools/ubuntu-24.04.txt does not name is as in requirements.txt. Which libraries there are is
# up to the packages' setup.py files, as anywhere but here.
$(UBUNTU_READY): tools/ubuntu-24.04.txt requirements.txt $(BUILD_FILES)
	@python=$$(sh tools/find_python.sh) || exit 2; \
	echo "seft: making $(UBUNTU) with $$python"; \
	rm -rf $(UBUNTU) && "$$python" -m venv $(UBUNTU)
	@sed 's/ *#.*//; s/\[.*\]//' tools/ubuntu-24.04.txt requirements.txt \
		| awk -F == 'NF == 2 && !seen[$$1]++' > $(UBUNTU)/constraints.txt
	$(call step,installing what Ubuntu 24.04 has (a minute or two), \
		$(UBUNTU_PIP) install -c $(UBUNTU)/constraints.txt setuptools wheel && \
		$(UBUNTU_PIP) install -c $(UBUNTU)/constraints.txt --no-build-isolation \
		"ros-jazzy-rclpy[fastrtps]" ros-jazzy-common-interfaces pytest-xdist \
		$(PACKAGES:%=-e %[test]))
	@pwd -P > $(UBUNTU_READY)
	@echo "seft: $(UBUNTU) is ready"
