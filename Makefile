# Everything runs in a virtual environment of its own, made on first use and brought up to date when
# pyproject.toml or requirements.lock changes.
VENV ?= .venv
PYTHON ?= $(firstword $(foreach p,python3 python3.14 python3.13 python3.12 python3.11 python,\
	$(shell $(p) -c 'import sys; sys.version_info >= (3, 11) and print("$(p)")' 2>/dev/null)) no-python-3.11-found)
INSTALL = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint requirements.lock --editable

.PHONY: demo test test-slow lock clean

demo: $(VENV)/.installed  ## plan the default job
	$(VENV)/bin/htcp plan

test: $(VENV)/.installed-test  ## lint and the quick tests
	$(VENV)/bin/ruff check .
	$(VENV)/bin/python -m pytest

test-slow: $(VENV)/.installed-test  ## every test
	$(VENV)/bin/python -m pytest -m "slow or not slow"

$(VENV)/bin/python:
	$(PYTHON) -m venv $(VENV)

$(VENV)/.installed: pyproject.toml requirements.lock | $(VENV)/bin/python
	@echo "Installing htcp_jax into $(VENV) (a few minutes the first time)"
	$(INSTALL) .
	touch $@

$(VENV)/.installed-test: pyproject.toml requirements.lock | $(VENV)/bin/python
	@echo "Installing htcp_jax and its test tools into $(VENV) (a few minutes the first time)"
	$(INSTALL) '.[test]'
	touch $@ $(VENV)/.installed

lock:  ## pin what a clean environment gets from pyproject.toml today
	rm -rf build/venv-lock
	$(PYTHON) -m venv build/venv-lock
	build/venv-lock/bin/python -m pip install --quiet --disable-pip-version-check '.[test]'
	build/venv-lock/bin/python -m pip freeze --exclude htcp_jax > requirements.lock

clean:
	rm -rf $(VENV) build
