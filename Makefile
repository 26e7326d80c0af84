# Everything a fresh machine needs is Python >= 3.11 with venv, make and git: `make demo`, `make test`.
PYTHON ?= python3
VENV := .venv
BIN := $(VENV)/bin
SECONDS ?=
FIGURE ?=
# Else every process that is started compiles all that it imports.
unexport PYTHONDONTWRITEBYTECODE

# Of the harnesses: how many, which seed, from which one on; also ROW, REAL, HOURS, MINUTES, JOBS. What each takes
# and shows stands in docs/proof.md.
N ?=
SEED ?=
FIRST ?=
WHAT ?=
FILES ?=
SAMPLE ?=
CHANGED ?=
EXTRAS ?=

.PHONY: all help demo test test-fast test-slow campaigns check computed lived format lint types imports bench coverage oracle fuzz \
	proof mutate clean faults soak kills lead-kills model cast pictures ros ros-if-here \
	install uninstall deb release release-check audit extras docs FORCE

all: $(VENV)/.ready
	@echo 'twind is installed in $(VENV). Next: . $(BIN)/activate, then twind --mode sim; make help lists the targets'

help:
	@echo 'make                      install twind into $(VENV), editable'
	@echo 'make demo                 start a virtual robot and its daemon, until Ctrl-C; SECONDS=60 ends it earlier'
	@echo 'make test                 run all tests but the slow ones; make test-fast: without real processes'
	@echo 'make check                run format, lint, types, documents, and all tests but the campaigns'
	@echo 'make campaigns            run the long forms of tests'
	@echo 'make extras EXTRAS=learn  add extras of pyproject.toml to $(VENV)'
	@echo 'make docs                 build the documents as a site, in site/'
	@echo 'make proof                run the proof campaign on, for days (docs/proof.md)'
	@echo 'make bench                measure this machine (docs/bench.md)'
	@echo 'sudo make install         install the service; sudo make uninstall removes it'
	@echo 'make deb                  build a Debian package, in dist/'
	@echo 'make release              build all that is published, in dist/; make release-check tries it'
	@echo 'make clean                remove $(VENV) and all that was built'

demo: $(VENV)/.ready
	$(BIN)/twindctl demo $(if $(SECONDS),--seconds $(SECONDS))

# Whose claim is timing has the machine to itself; the others share it.
test: $(VENV)/.ready
	$(BIN)/pytest -n auto --dist worksteal --ignore tests/end_to_end
	$(BIN)/pytest -n 2 --dist loadfile --no-loadscope-reorder tests/end_to_end/concurrent tests/end_to_end/wired
	$(BIN)/pytest tests/end_to_end/exclusive

test-fast: $(VENV)/.ready
	$(BIN)/pytest -n auto --dist worksteal --ignore tests/end_to_end

test-slow: $(VENV)/.ready
	$(BIN)/pytest -n auto -m slow --ignore tests/end_to_end
	$(BIN)/pytest -m slow tests/end_to_end

# The long forms of claims that shorter tests make in `make check`: a trained policy, a thousand faults, minutes of a life.
campaigns: $(VENV)/.learn
	$(BIN)/pytest -n auto -m campaign --ignore tests/end_to_end
	$(BIN)/pytest -m campaign tests/end_to_end

# All tests but the campaigns, fast and slow together, so that they are collected no more often than they must. What
# learning needs, and the real rclpy where it can be had, is installed while what needs none of it looks at the sources.
# The site of the documents is built by its tests (tests/docs/test_docs_site.py). Computing that has only what nobody
# else wants fills the time that real processes sleep. Beside tests that speak over pseudo-terminals nothing computes;
# three at once took 410 and 557 s on two cores, two 570 s, and more of them failed. Tests whose claim is timing have the
# machine to themselves. An end-to-end test that fails there runs once more, alone, at the end (tools/second_run.py).
check: $(VENV)/.ready
	$(MAKE) $(TWO) format lint types $(VENV)/.learn ros-if-here
	$(MAKE) --no-print-directory $(VENV)/.docs
	$(MAKE) $(TWO) imports computed lived
	$(BIN)/python tools/second_run.py first tests/end_to_end/wired -n 2 --dist loadfile --no-loadscope-reorder
	$(BIN)/python tools/second_run.py first tests/end_to_end/exclusive
	$(BIN)/python tools/second_run.py again $(addprefix tests/end_to_end/,concurrent wired exclusive)

TWO := --no-print-directory --jobs 2 --output-sync --keep-going
IDLE := $(shell chrt --idle 0 true 2>/dev/null && echo chrt --idle 0)

computed: $(VENV)/.ready
	$(IDLE) $(BIN)/pytest -n auto --dist worksteal -m 'not campaign' --ignore tests/end_to_end

lived: $(VENV)/.ready
	$(BIN)/python tools/second_run.py first tests/end_to_end/concurrent -n 2 --dist loadfile --no-loadscope-reorder

format: $(VENV)/.ready
	$(BIN)/ruff format --check .

lint: $(VENV)/.ready
	$(BIN)/ruff check .
	$(BIN)/python tools/check_names.py

types: $(VENV)/.ready
	$(BIN)/mypy

imports: $(VENV)/.ready
	$(BIN)/lint-imports

bench: $(VENV)/.bench $(VENV)/.learn
	$(BIN)/python -m bench $(FIGURE) $(if $(BASE),--base $(BASE)) $(if $(MINUTES),--minutes $(MINUTES))

coverage: $(VENV)/.ready
	$(BIN)/coverage erase
	$(BIN)/python -m tests.proof.mutation.coverage

# All harnesses on, each with its next inputs, up to the goals of the version: days. It tells first how many hours.
proof: $(VENV)/.ready
	$(BIN)/python -m tests.proof.campaign $(foreach each,$(SUBJECT),--subject '$(each)') $(if $(HOURS),--hours $(HOURS)) \
		$(if $(AGAIN),--again)

oracle: $(VENV)/.ready
	$(BIN)/python -m tests.proof.oracle $(if $(N),-n $(N)) $(if $(SEED),--seed $(SEED)) $(if $(FIRST),--first $(FIRST))

fuzz: $(VENV)/.ready
	$(BIN)/python -m tests.proof.fuzz $(if $(N),-n $(N)) $(if $(SEED),--seed $(SEED)) $(if $(FIRST),--first $(FIRST)) \
		$(foreach each,$(WHAT),--what $(each))

mutate: $(VENV)/.ready
	$(BIN)/python -m tests.proof.mutation $(FILES) $(if $(SAMPLE),--sample $(SAMPLE)) \
		$(if $(CHANGED),--changed $(CHANGED)) $(if $(SECONDS),--seconds $(SECONDS))

faults: $(VENV)/.ready
	$(BIN)/python -m tests.proof.faults.run $(if $(N),--number $(N)) $(if $(ROW),--rows $(ROW)) \
		$(if $(SEED),--seed $(SEED)) $(if $(REAL),--real $(REAL)) $(if $(HOURS),--hours $(HOURS)) \
		$(if $(FIRST),--first $(FIRST))

soak: $(VENV)/.ready
	$(BIN)/python -m tests.proof.soak.run $(if $(HOURS),--hours $(HOURS)) $(if $(JOBS),--jobs $(JOBS)) \
		$(if $(SEED),--seed $(SEED)) $(if $(ROBOT),--robot $(ROBOT)) $(if $(MINUTES),--minutes $(MINUTES)) \
		$(if $(REAL),--real)

kills: $(VENV)/.ready
	$(BIN)/python -m tests.support.sigkill_runs $(N) $(if $(SEED),--seed $(SEED))

lead-kills: $(VENV)/.ready
	$(BIN)/python -m tests.support.unwatched_kills $(N) $(if $(ROBOT),--robot $(ROBOT)) $(if $(SEED),--seed $(SEED))

model: $(VENV)/.ready
	$(BIN)/python -m tests.proof.model $(N) $(if $(SEED),--seed $(SEED))

# A terminal recorded: docs/calibration.cast, and what it shows in calibration/README.md.
cast: $(VENV)/.ready
	$(BIN)/python -m tests.support.make_calibration_cast

# docs/pictures: browser, terminal and page of a virtual robot that waves; several on one page; the built-in robots; a
# learner's robot, and how it learns; the gap before and after identification. Needs Chromium, and a machine that is calm.
pictures: $(VENV)/.learn
	$(BIN)/python -m tests.support.make_pictures
	$(BIN)/python -m tests.support.make_fleet_picture
	MUJOCO_GL=egl $(BIN)/python -m tests.support.make_gallery_picture
	$(BIN)/python -m tests.support.make_learn_pictures
	$(BIN)/python -m tests.support.make_gap_picture

# A searchable site of all pages, in site/. A dead link or anchor fails.
docs: $(VENV)/.docs
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build --strict

# What a machine gets, and where; DESTDIR, WHEELS, PURGE and the rest stand in packaging/install.sh. An interpreter is
# named to these only where it was named to make: `python3` may be one below /root, which the service does not see.
NAMED := $(if $(filter file,$(origin PYTHON)),,PYTHON='$(PYTHON)')

install:
	$(NAMED) packaging/install.sh install

uninstall:
	$(NAMED) packaging/install.sh uninstall

deb:
	$(NAMED) packaging/deb.sh dist

release:
	$(NAMED) packaging/release.sh dist

# What `make release` built: built again with the same bytes, installed and started in an empty environment of each
# Python of this machine.
release-check:
	$(PYTHON) tools/check_release.py dist

# What twind brings, looked up among published vulnerabilities. Needs the network.
audit:
	$(NAMED) packaging/sbom.sh audit

ADD = $(BIN)/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable

# Further extras of pyproject.toml in this environment, such as EXTRAS=learn,view. Always editable: a copy of
# the sources would hide every later edit.
extras: $(VENV)/.ready
	@test -n '$(EXTRAS)' || { echo 'extras: name them: make extras EXTRAS=learn,view' >&2; exit 2; }
	$(ADD) '.[dev,$(EXTRAS)]'

# Not empty where the environment has a twind that is no editable install of this folder.
COPIED := $(if $(wildcard $(VENV)/.ready),$(shell grep -qsxF '$(CURDIR)' \
	$(VENV)/lib/python*/site-packages/*.pth || echo yes))

# The stamp makes a half-finished environment start over.
$(VENV)/.ready: pyproject.toml $(if $(COPIED),FORCE)
	$(if $(COPIED),@echo '$(VENV) has a twind that is not this folder: it is installed editable again')
	$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "twind needs Python 3.11 or newer; set PYTHON=")'
	$(PYTHON) -m venv $(VENV)
	@$(BIN)/pip uninstall --quiet --yes twind 2>/dev/null # the earlier name of the distribution
	$(ADD) '.[dev]'
	touch $@

# The learning extras: hundreds of megabytes, so `make test` does without, and skips their tests.
$(VENV)/.learn: $(VENV)/.ready constraints.txt
	$(ADD) '.[dev,learn]'
	touch $@

# The real rclpy, in an environment of its own, for tests and for `twindctl ros` in the clone. Needs CPython 3.12. `empy` has no wheel.
# Version managers keep Pythons in folders side by side.
BESIDE = $(shell $(PYTHON) -c 'import os, sys; print(os.path.dirname(sys.base_prefix))')
PYTHON312 ?= $(firstword $(wildcard $(BESIDE)/*3.12*/bin/python3.12) python3.12)

ros: $(VENV)/ros/.ready

ros-if-here:
	@$(PYTHON312) -c '' 2>/dev/null && $(MAKE) --no-print-directory ros || echo 'no real rclpy: its tests are skipped'

$(VENV)/ros/.ready: constraints-ros.txt | $(VENV)/.ready
	$(PYTHON312) -m venv $(VENV)/ros
	$(VENV)/ros/bin/pip install --quiet --disable-pip-version-check --only-binary :all: --no-binary empy \
		--requirement constraints-ros.txt
	touch $@

$(VENV)/.docs: $(VENV)/.ready
	$(ADD) '.[dev,docs]'
	touch $@

$(VENV)/.bench: $(VENV)/.ready
	$(ADD) '.[dev,bench]'
	touch $@

clean:
	rm -rf $(VENV) dist build site .mypy_cache .ruff_cache .pytest_cache .hypothesis
