# `make` alone lists what can be made. Every target sets up .venv first, where it has to.

VENV     := .venv
PYTHON   ?= $(shell command -v python3.11 || command -v python3)
TAILBEAT := $(VENV)/bin/tailbeat
READY    := $(VENV)/.installed

# Measured and made recordings. Tests that need them are skipped where they are absent.
TAILBEAT_DATA ?= $(abspath ../shared/data)
export TAILBEAT_DATA

# Compiled Python files are kept, or every process that a test starts compiles the sources anew.
unexport PYTHONDONTWRITEBYTECODE

# More options for the command that a target runs: make swim ARGS="--seed 3"
ARGS ?=

PAGES := README.md CHANGELOG.md CONTRIBUTING.md SECURITY.md docs

.DEFAULT_GOAL := help
.PHONY: help mutation thorough swim benchmark results docs test tests check format browser clean

help:  ## list the targets
	@grep -hE '^[a-z]+:.*## ' $(MAKEFILE_LIST) | sed -E 's/^([a-z]+):.*## /\1\t/' | expand -t 10

swim: $(READY)  ## the main job: open the printed address, drag the target
	$(TAILBEAT) swim $(ARGS)

benchmark: $(READY)  ## measure speed on this machine
	$(TAILBEAT) benchmark $(ARGS)

results: $(READY)  ## make the numbers of docs/results that are missing or stale (hours in all; ARGS names some)
	$(VENV)/bin/python tools/results.py $(ARGS)

docs: export NO_MKDOCS_2_WARNING = 1
docs: $(READY)  ## build the documentation site into build/site; a wrong link is an error
	$(VENV)/bin/mkdocs build --strict $(ARGS)

# A test that measures time fails where the machine stops for a moment. Such a test has a second try,
# alone; both are printed. Every other test that fails, and one that fails twice, ends in an error.
test: browser  ## check and, at the same time, every test that is neither slow nor needs a GPU
	@$(MAKE) --no-print-directory -j 2 check tests

AGAIN = $(VENV)/bin/pytest --last-failed --last-failed-no-failures none --again

tests: $(READY)
	$(VENV)/bin/pytest -n auto --no-loadscope-reorder $(ARGS) || { test $$? = 1 && $(AGAIN); }

thorough: $(READY)  ## the tests that take longer than all of `make test` leaves time for
	$(VENV)/bin/pytest -n auto --no-loadscope-reorder -m "thorough and not slow" $(ARGS) || \
	{ test $$? = 1 && $(AGAIN) -m "thorough and not slow"; }

mutation: $(READY)  ## change the code in one place at a time; which changes does no test notice? (half an hour)
	$(VENV)/bin/python tests/mutation.py $(ARGS)

check: $(READY)  ## lint, format, types, spelling and prose, changing nothing
	$(VENV)/bin/ruff check
	$(VENV)/bin/ruff format --check
	$(VENV)/bin/mypy
	$(VENV)/bin/codespell $(PAGES) src tests tools examples
	$(VENV)/bin/proselint --config .proselintrc.json check $(PAGES)
	$(VENV)/bin/python tools/prose.py

format: $(READY)  ## put imports and layout right
	$(VENV)/bin/ruff check --fix
	$(VENV)/bin/ruff format

browser:  ## chromium for the operator page's test, where it is missing (Debian, as root or by sudo)
	@{ command -v chromedriver && command -v chromium; } >/dev/null || { command -v apt-get >/dev/null && { \
	  test "$$(id -u)" = 0 || elevated=sudo; \
	  $$elevated apt-get update -qq && $$elevated apt-get install -qq -y chromium chromium-driver; }; } || \
	{ echo "make browser: no chromedriver here and apt-get cannot install it: install Chromium and its"; \
	  echo "chromedriver by hand and put both on the PATH."; exit 1; }

clean:  ## remove caches and builds; runs/ and .venv stay
	rm -rf build dist .pytest_cache .mypy_cache .ruff_cache
	find src tests -name __pycache__ -type d -prune -exec rm -rf {} +

$(READY): pyproject.toml constraints.txt
	test -x $(VENV)/bin/python || $(PYTHON) -m venv $(VENV)
	$(VENV)/bin/pip install -q -c constraints.txt -e '.[all,cluster,dev,docs]'
	@touch $@
