# make demo    identify a hydraulic model from the sample recordings: costs and a report, without ROS
# make test    lint, types, tests; the ROS tests too where ROS 2 is sourced. What needs a program that is not installed
#              is skipped, and a line at the end says what to install
# make test-fast  lint and the tests that are not marked slow: a developer's loop, a good minute
# make test-bare  a part of the tests without those programs, as on a bare machine; .ci/run does this and then `test`
# make bench   speed, each beside what it is compared with
# make tables  the tables of figures in docs/, or those of TABLES='thesis measured', by the commands in the pages; all take
#              days, some need ROS 2 or the measured recordings (CES_DATA=FOLDER)
# make reference  docs/reference/*.md anew, from the declarations in the code
# make docs    the documentation site, into out/site (its search needs a server: python3 -m http.server -d out/site)
# make clean   remove what make made
#
# VENV=.venv and PYTHON=python3 can be given. Nothing is installed outside VENV.
VENV ?= .venv
PYTHON ?= python3

# A sourced ROS 2 puts its own Python's packages on PYTHONPATH: they have no place in this environment.
RUN := env -u PYTHONPATH $(VENV)/bin
OUT := out
TABLES ?= thesis
CORE := $(wildcard ces_observer/tick/*.py ces_identify/export/c_*.py ces_identify/export/tick_module.c)

.PHONY: demo test test-fast test-bare lint suite test-ros bench tables reference docs clean

demo: $(VENV)/.installed
	@mkdir -p $(OUT)
	$(RUN)/ces identify bags/noise bags/sweep --validate bags/sine_4hz bags/road --structure hydraulic \
	  --out $(OUT)/model.json --report $(OUT)/report.html --overwrite

test: lint test-ros suite

test-fast: $(VENV)/.installed-dev
	$(RUN)/ruff check .
	$(RUN)/python -m pytest --ignore=test/ros -n auto --dist loadfile -m "not slow"

lint: $(VENV)/.installed-dev
	$(RUN)/ruff check .
	$(RUN)/ruff format --check .
	$(RUN)/mypy

suite: $(VENV)/.installed-dev
	$(RUN)/python -m pytest --ignore=test/ros -n auto --dist loadfile

test-bare: $(VENV)/.installed-dev
	@test/run_bare $(VENV)/bin/python

test-ros:
	@test/ros/run

bench: $(VENV)/.installed-dev
	@for script in bench/bench_*.py; do echo "== $$script"; $(RUN)/python $$script || exit 1; done

tables: $(VENV)/.installed-dev
	$(RUN)/python -m bench.write_tables $(TABLES)

reference: $(VENV)/.installed-dev
	$(RUN)/python -m bench.reference

docs: $(VENV)/.installed-docs
	NO_MKDOCS_2_WARNING=1 $(RUN)/mkdocs build --quiet --strict --site-dir $(OUT)/site
	@echo "$(OUT)/site/index.html"

clean:
	rm -rf $(OUT) build dist *.egg-info ces_observer/_tick*.so .pytest_cache .mypy_cache .ruff_cache .hypothesis
	@if [ -f $(VENV)/.made ]; then echo "rm -rf $(VENV)"; rm -rf $(VENV); fi

# Without --no-compile, half of the time would go into modules that nobody imports.
$(VENV)/.installed: setup.py pyproject.toml $(CORE) | $(VENV)/bin/python
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --no-compile --editable .
	@touch $@

$(VENV)/.installed-dev: setup.py pyproject.toml $(CORE) | $(VENV)/bin/python
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --editable '.[dev]'
	$(RUN)/ces schema --all ces_identify/schemas
	@touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: setup.py pyproject.toml | $(VENV)/bin/python
	$(RUN)/python -m pip install --quiet --disable-pip-version-check --editable '.[docs]'
	@touch $@ $(VENV)/.installed

$(VENV)/bin/python:
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "make: $(PYTHON) is missing or older than 3.11; name a newer one: make PYTHON=python3.12" >&2; exit 2; }
	@$(PYTHON) -c 'import ensurepip' 2> /dev/null || \
	  { echo "make: Python's venv module is missing; install it: sudo apt install python3-venv" >&2; exit 2; }
	env -u PYTHONPATH $(PYTHON) -m venv $(VENV)
	@touch $(VENV)/.made
