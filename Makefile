# smfe: `make demo` needs Python 3.11 or later, make and a network; everything else is installed in .venv.
SHELL = /bin/sh

# INSTALL=wheel builds the wheel, installs it in a venv of its own and works with that instead of the checkout.
INSTALL = editable
JOBS = 2
PYTHON := $(shell for p in $(PYTHON) python3 python3.13 python3.12 python3.11 python; do \
	"$$p" -c 'import sys; sys.exit(sys.version_info < (3, 11))' 2>/dev/null && echo "$$p" && break; done)

ifeq ($(INSTALL),wheel)
VENV = .venv-wheel
READY = wheel-installed
else
VENV = .venv
READY = $(VENV)/.installed
endif
BIN = $(VENV)/bin
UV_INSTALL = $(BIN)/uv pip install --quiet --python $(BIN)/python --no-deps --no-build-isolation --compile-bytecode

# What the tests run with: one BLAS thread (many small matrices), no display, and public data where it lies beside us.
# Bytecode is kept whatever the shell says: without it each worker and each process compiles all tests and smfe anew.
RUN = OPENBLAS_NUM_THREADS=1 OMP_NUM_THREADS=1 MPLBACKEND=Agg PYTHONDONTWRITEBYTECODE=
ifeq ($(INSTALL),wheel)
RUN += SMFE_TEST_WHEEL=1
endif
ifneq ($(wildcard ../shared/data),)
SMFE_DATA ?= $(CURDIR)/../shared/data
export SMFE_DATA
endif

.PHONY: help demo kernels test one page paper figure slow calibrations exam exam-campaigns exam-machine accuracy strangers ram fuzz lint docs bench lock wheel clean wheel-installed

help:
	@echo "make demo    run the demonstration and write its report to demo/"
	@echo "make test    the tests, without the slow ones (INSTALL=wheel: of the installed wheel; ARGS=... for pytest)"
	@echo "make kernels compile what numba compiles, once (two minutes); kept in .cache by content"
	@echo "make one     one file of tests: T=tests/process/cut/test_force.py"
	@echo "make page    one page of the documentation: PAGE=hammer"
	@echo "make paper   the pages that remake the paper's figures, every number checked"
	@echo "make figure  figures of a folder of results: RESULTS=demo/results NAME=lobes"
	@echo "make slow    the slow tests"
	@echo "make calibrations  tests that count over many seeds"
	@echo "make exam    hidden effects, found or not: writes docs/exam.md (a day; ARGS=\"--nulls 30 --seeds 4 --sizes 0\" for less)"
	@echo "make exam-campaigns  the same through campaign files of imperfect machines (12 hours of CPU, resumable; ARGS=\"--minutes 90\")"
	@echo "make exam-machine  the same of a portal with three feed axes, at rest and in motion (5 hours of CPU)"
	@echo "make outside records of others, where copies lie: writes docs/outside_table.md (SMFE_BRB, SMFE_SONODE; ten minutes)"
	@echo "make accuracy  errors of the sweep estimators: writes docs/accuracy_table.md and docs/sweep_table.md (ten minutes)"
	@echo "make strangers  records that nobody prepared, drawn at random: writes the tables in docs/ (an hour)"
	@echo "make ram     cutting tests of the paper's ram machine, five seeds: writes docs/ram_table.md (ten minutes)"
	@echo "make fuzz    damaged files of every format, resumable: writes docs/fuzz_table.md (ARGS=\"--minutes 30\" for less)"
	@echo "make lint    ruff, mypy, import-linter, checks of files and structure"
	@echo "make docs    the documentation, with its examples run, to docs/_build/html"
	@echo "make bench   the benchmarks"
	@echo "make wheel   build and check dist/*.whl"
	@echo "make lock    renew requirements.lock"
	@echo "make clean   remove everything that make made"

demo: $(READY)
	$(BIN)/smfe demo --out demo

# Kernels are compiled once, before the workers start, and kept by content: tests/compile_kernels.py.
kernels: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python tests/compile_kernels.py --jobs $(JOBS)

test: $(READY) kernels
	$(RUN) $(BIN)/pytest -m "not slow and not exam" -n $(JOBS) --dist worksteal $(ARGS)

# Exit code 5 says that no test is marked slow.
# One file or folder of tests, with what pytest has cached: make one T=tests/process/cut ARGS="-k helix"
one: $(READY) kernels
	$(RUN) $(BIN)/pytest $(T) -x $(ARGS)

slow: $(READY) kernels
	$(RUN) $(BIN)/pytest -m "slow and not exam" -n $(JOBS) --dist worksteal $(ARGS) || [ $$? -eq 5 ]

calibrations: $(READY) kernels
	$(RUN) $(BIN)/pytest -m exam -n $(JOBS) --dist worksteal $(ARGS)

exam: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.sitting docs/exam.md --jobs $(JOBS) $(ARGS)

exam-campaigns: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.campaigns docs/exam_campaigns_table.md --jobs $(JOBS) $(ARGS)

exam-machine: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.machine docs/machine_exam_table.md --jobs $(JOBS) $(ARGS)

outside: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.outside.table docs/outside_table.md $(ARGS)

accuracy: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m accuracy.table docs/accuracy_table.md $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m accuracy.theory_table docs/sweep_table.md

strangers: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.sweep_strangers docs/sweep_strangers_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.modes docs/modes_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.frf_files docs/frf_files_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.excitations docs/excitations_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.check docs/check_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.plan docs/plan_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.limits_agree docs/limits_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.chatter docs/chatter_table.md --jobs $(JOBS) $(ARGS)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.drive_records docs/drive_records_table.md --jobs $(JOBS) $(ARGS)

# Sixty cutting tests of the paper's ram machine, five seeds: what section 6 of docs/paper shows.
ram: $(READY) kernels
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.ram docs/ram_table.md --jobs $(JOBS) $(ARGS)

# Resumes where the last sitting stopped (fuzz_state.json); a million inputs take some hours.
fuzz: $(READY)
	$(RUN) PYTHONPATH=tests $(BIN)/python -m exam.fuzz docs/fuzz_table.md $(ARGS)

lint: $(READY)
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports
	$(BIN)/python .ci/check_files.py
	$(BIN)/python .ci/check_structure.py

# Built afresh (-E): a page that Sphinx does not read again gives no warning again.
docs: $(READY)
	$(RUN) $(BIN)/sphinx-build -j $(JOBS) -E -W --keep-going -q -b html docs docs/_build/html
	@echo "docs/_build/html/index.html"

# One page, its examples run: make page PAGE=hammer
page: $(READY)
	$(RUN) SMFE_PAGE=$(PAGE) $(BIN)/sphinx-build -q -b html docs docs/_build/page
	@echo "docs/_build/page/$(PAGE).html"

# The pages that remake the paper, every number checked against what is computed.
paper: $(READY)
	$(RUN) SMFE_PAGE="paper/*" $(BIN)/sphinx-build -j $(JOBS) -E -q -b html docs docs/_build/page
	@echo "docs/_build/page/paper/index.html"

# The figures of a folder of results, drawn again: make figure RESULTS=demo/results NAME=lobes
RESULTS = demo/results
figure: $(READY)
	$(RUN) $(BIN)/python .ci/figure.py $(RESULTS) $(NAME)

bench: $(READY)
	@set -- benchmarks/*.py; test -e "$$1" || { echo "benchmarks/ holds no benchmark" >&2; exit 1; }
	$(RUN) $(BIN)/pytest benchmarks --benchmark-only -s $(ARGS)

wheel: $(VENV)/.locked
	rm -rf dist
	$(BIN)/hatchling build -t wheel
	$(BIN)/python .ci/check_wheel.py dist/*.whl

lock: $(VENV)/.locked
	$(BIN)/uv pip compile pyproject.toml --group dev --upgrade --universal --python-version 3.11 --generate-hashes \
		--no-emit-index-url --no-emit-find-links --no-header --no-annotate --quiet --output-file requirements.lock

clean:
	rm -rf .venv .venv-wheel dist demo docs/_build docs/_made .cache .pytest_cache .mypy_cache .ruff_cache .import_linter_cache \
		.benchmarks .hypothesis
	find smfe process stability tests docs benchmarks .ci -name __pycache__ -prune -exec rm -rf {} +

# pip installs uv alone, at the version and with the hashes of the lock; uv installs the rest, about five times faster.
# Bytecode is compiled here because a warning that Python gives while compiling would be an error under pytest.
$(VENV)/.locked: requirements.lock
	@test -n "$(PYTHON)" || { echo "smfe needs Python 3.11 or later; name it with: make PYTHON=..." >&2; exit 1; }
	test -x $(BIN)/python || $(PYTHON) -m venv $(VENV)
	awk '/^[^ ]/ { keep = /^uv==/ } keep' requirements.lock > $(VENV)/uv.txt
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r $(VENV)/uv.txt
	$(BIN)/uv pip sync --quiet --python $(BIN)/python --require-hashes --compile-bytecode requirements.lock
	rm -f $(VENV)/.installed
	touch $@

.venv/.installed: .venv/.locked pyproject.toml
	$(UV_INSTALL) --editable .
	touch $@

wheel-installed: wheel
	$(UV_INSTALL) --reinstall dist/*.whl
