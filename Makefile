# Everything runs in a virtual environment of its own, made on first use and brought up to date when
# pyproject.toml or requirements.lock changes.
VENV ?= .venv
PYTHON ?= $(firstword $(foreach p,python3 python3.14 python3.13 python3.12 python3.11 python,\
	$(shell $(p) -c 'import sys; sys.version_info >= (3, 11) and print("$(p)")' 2>/dev/null)) no-python-3.11-found)
INSTALL = $(VENV)/bin/python -m pip install --quiet --disable-pip-version-check --constraint requirements.lock --editable

COMMA := ,
# As many processes as there are cores share the tests. WHOLE=1 executes the annotations of the whole package, and not
# only of the modules that pyproject.toml names.
PYTEST = $(VENV)/bin/python -m pytest --numprocesses logical --dist worksteal \
	$(if $(WHOLE),--jaxtyping-packages=htcp_jax$(COMMA)beartype.beartype)
# Tests that read files only: without JAX, annotations and the fixtures of the others.
TEXT = --override-ini=addopts=--quiet --override-ini=pythonpath=tests --confcutdir=tests/text tests/text
# What `make check` runs: the mathematics; a small plan and bad inputs by the command.
CHECKED = $(patsubst %,tests/test_%.py,mathematics numerics kinematics sphere qp cma_es cli)

.PHONY: demo install lint types texts check test test-changed test-slow test-oldest notebooks docs gate update-baselines gate-runs gate-faults faults fuzz strangers lock \
	release-check clean

demo: $(VENV)/.installed  ## plan the default job, and compile what the first plans of other jobs need
	$(VENV)/bin/htcp plan
	@echo "Next: programs for your own jobs, over two minutes on two cores. Ctrl-C ends it; .venv/bin/htcp prepare does the rest later"
	$(VENV)/bin/htcp prepare

lint: $(VENV)/.installed-test  ## style, imports, docstrings, shape annotations, types
	$(VENV)/bin/ruff check .
	@$(MAKE) --no-print-directory --jobs 2 types texts
	@$(VENV)/bin/python -m benchmarks gpu --check || true

types: $(VENV)/.installed-test
	$(VENV)/bin/mypy

texts: $(VENV)/.installed-test
	$(VENV)/bin/python tests/lint.py
	$(VENV)/bin/python -m pytest $(TEXT)

check: lint  ## a first answer: lint, a self-test, the mathematics, a small plan, bad inputs
	@echo "A first answer: two minutes on two cores the first time"
	$(VENV)/bin/htcp doctor
	$(PYTEST) $(CHECKED)

test: lint  ## lint and the quick tests
	@echo "The quick tests: 25 minutes on two cores the first time, fewer once programs are compiled"
	$(PYTEST)

BASE = HEAD
test-changed: lint  ## the quick tests that a change since the commit BASE can break
	files=$$($(VENV)/bin/python tests/changed.py $(BASE)) && if [ -n "$$files" ]; then $(PYTEST) $$files; fi

test-slow: WHOLE = 1
test-slow: export HTCP_CACHE = $(CURDIR)/build/cache
test-slow: lint  ## every test, with all annotations executed and nothing compiled yet
	rm -rf build/cache
	$(PYTEST) -m "slow or not slow"

gate-faults: $(VENV)/.installed-test  ## the tests that the gate notices a fault in each part of a plan
	$(PYTEST) -m slow tests/test_gate_faults.py

OLDEST = build/venv-oldest/bin
test-oldest:  ## the quick tests, or TESTS="FILES", with the oldest allowed versions of the direct dependencies
	$(PYTHON) -m venv build/venv-oldest
	$(OLDEST)/python -m pip install --quiet --disable-pip-version-check uv
	$(OLDEST)/uv pip install --quiet --python $(OLDEST)/python --resolution lowest-direct --editable '.[test]'
	$(OLDEST)/python -m pytest $(TESTS)

NOTEBOOKS = $(basename $(notdir $(wildcard notebooks/[0-9]*.py)))
notebooks: $(VENV)/.installed-notebooks  ## execute the notebooks: outputs in notebooks/*.ipynb, and build/notebooks/*.html
	$(VENV)/bin/python notebooks/make.py $(NOTEBOOKS)
	$(VENV)/bin/jupyter-nbconvert --log-level ERROR --to html --output-dir build/notebooks $(NOTEBOOKS:%=notebooks/%.ipynb)

docs: $(VENV)/.installed-docs  ## build the documentation into build/site, warnings are errors
	NO_MKDOCS_2_WARNING=1 $(VENV)/bin/mkdocs build --strict

# The runs that `htcp gate` holds to sweeps/baselines/, in the folder RUNS: three sweeps by every method; the paper's two
# tables by its six methods, under the paper's choices; and one table with other joint weights, where J1 decides.
GATED = workpiece starts-part seams-part paper-workpiece paper-robot port-workpiece
RUNS = build/gate
GATE = $(VENV)/bin/htcp gate $(RUNS)/$$run --baseline sweeps/baselines/$$run.yaml
SWEEP = $(VENV)/bin/htcp sweep
PAPER = --config configs/paper.yaml --methods baseline,cspace-sample,nspace-sample,nspace-sqp,nspace-ip,nspace-cmaes

gate: gate-runs  ## plan the gated sweeps and hold them to their baselines
	@failed=0; for run in $(GATED); do \
		$(GATE) --junit $(RUNS)/$$run.xml --markdown "$${GITHUB_STEP_SUMMARY:-$(RUNS)/gate.md}" || failed=1; \
	done; exit $$failed

update-baselines: gate-runs  ## plan the gated sweeps and make them the new baselines
	@set -e; for run in $(GATED); do $(GATE) --update; done

gate-runs: $(VENV)/.installed
	rm -rf $(RUNS)
	$(SWEEP) sweeps/workpiece.yaml --out $(RUNS)/workpiece
	$(SWEEP) sweeps/starts-part.yaml --out $(RUNS)/starts-part
	$(SWEEP) sweeps/seams-part.yaml --out $(RUNS)/seams-part
	$(SWEEP) sweeps/workpiece.yaml $(PAPER) --out $(RUNS)/paper-workpiece
	$(SWEEP) sweeps/robot.yaml $(PAPER) --out $(RUNS)/paper-robot
	$(SWEEP) sweeps/workpiece.yaml --config configs/port.yaml --methods nspace-sqp --out $(RUNS)/port-workpiece
	$(VENV)/bin/htcp reachability sweeps/workpiece.yaml --out $(RUNS)/workpiece

faults: $(VENV)/.installed-test  ## kill drivers, workers and nodes, fill disks, and compare bytes: a quarter of an hour
	$(VENV)/bin/python -m pytest -m "slow or not slow" -v tests/test_faults.py tests/test_sweep_ray.py

fuzz: $(VENV)/.installed-test  ## 100,000 damaged inputs for every reader; FUZZ="INPUTS SEED" for others
	$(VENV)/bin/python tests/fuzz.py $(FUZZ)

strangers: $(VENV)/.installed-test  ## jobs on published arms, checked with their original meshes: an hour, or ONLY="NAME,..."
	$(VENV)/bin/python -m benchmarks strangers --record $(if $(ONLY),--only $(ONLY))
	$(VENV)/bin/python -m benchmarks strangers --page

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

install: pyproject.toml requirements.lock | $(VENV)/bin/python  ## install in one go what all these commands need
	@echo "Installing htcp_jax and all its tools into $(VENV) (a few minutes the first time)"
	$(INSTALL) '.[test,notebooks,docs]'
	touch $(VENV)/.installed $(VENV)/.installed-test $(VENV)/.installed-notebooks $(VENV)/.installed-docs

$(VENV)/.installed-notebooks: pyproject.toml requirements.lock | $(VENV)/bin/python
	@echo "Installing htcp_jax and what executes notebooks into $(VENV)"
	$(INSTALL) '.[notebooks]'
	touch $@ $(VENV)/.installed

$(VENV)/.installed-docs: pyproject.toml requirements.lock | $(VENV)/bin/python
	@echo "Installing htcp_jax and what builds its documentation into $(VENV)"
	$(INSTALL) '.[docs]'
	touch $@ $(VENV)/.installed

lock:  ## pin what a clean environment gets from pyproject.toml today
	rm -rf build/venv-lock
	$(PYTHON) -m venv build/venv-lock
	build/venv-lock/bin/python -m pip install --quiet --disable-pip-version-check '.[test,notebooks,docs]'
	build/venv-lock/bin/python -m pip freeze --exclude htcp_jax > requirements.lock

release-check: $(VENV)/.installed  ## refuse the tag TAG if it is not the version, or if GPU figures are of other planning code
	@grep -qFx 'version = "$(TAG:v%=%)"' pyproject.toml || { echo "TAG=$(TAG) is not the version in pyproject.toml"; exit 1; }
	@$(VENV)/bin/python -m benchmarks gpu --check

clean:
	rm -rf $(VENV) build
