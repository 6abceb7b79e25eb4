# make demo      the quickstart study and its report
# make test      what continuous integration runs
# make verify    the long verification runs; their table goes to results/verification.md
# make docs      the generated parts of the documents, and the site in build/site
# make baselines REASON="why": accepts the accuracy of the gated studies as it is now
# make evidence  WHAT=name: measures anew what a documented table shows, in one thread, for minutes to hours;
#                names, rows and durations are in tools/evidence.toml
# Each sets up what it needs: .venv, pinned packages, and the shared libraries of gmsh and VTK.

PYTHON ?= python3
RUN := .venv/bin/
ONE_THREAD := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1
PIP := .venv/bin/pip install --disable-pip-version-check --constraint constraints.txt
# bytecode is kept also where the environment says no: to collect the tests takes half as long with it
PYTEST := PYTHONDONTWRITEBYTECODE= $(ONE_THREAD) $(RUN)python -m pytest

.PHONY: demo test verify docs baselines evidence setup clean

demo: libraries .venv/installed
	$(RUN)vdmbench run quickstart
	@echo "next: . .venv/bin/activate   puts the command vdmbench on this shell's path"

test: setup
	$(RUN)ruff check .
	$(RUN)ruff format --check .
	@mkdir -p build/typed && ln -sfn ../../studies build/typed/vdmbench
	$(RUN)mypy & types=$$!; \
	$(PYTEST) -n $$(nproc) --dist worksteal -m "not slow" --timeout 600 --timeout-method thread; tests=$$?; \
	wait $$types || { echo 'mypy found errors: see above'; exit 1; }; exit $$tests

verify: setup
	$(PYTEST) --verification -m "anchor or slow"

# SURFACE=liver.obj draws the front page's picture with a real liver
docs: setup
	$(RUN)python -m tools.documents $(SURFACE)
	$(RUN)mkdocs build --quiet

baselines: setup
	@test -n "$(REASON)" || { echo 'say why: make baselines REASON="..."'; exit 2; }
	for study in quickstart regression; do \
	  $(RUN)vdmbench run $$study && $(RUN)vdmbench accept results/runs/$$study --reason "$(REASON)" || exit 1; done

# ARGS are the table's own: a liver.obj for accuracy, ratios, parts, scans, performance; studies for error_bars, scenes
evidence: setup
	@test -n "$(WHAT)" || { echo 'say what: make evidence WHAT=claims'; exit 2; }
	$(if $(filter league measured,$(WHAT)),$(PIP) --quiet ./docs/examples)
	$(ONE_THREAD) $(RUN)python -m tools.evidence $(WHAT) $(ARGS)

setup: libraries .venv/ready

.venv/installed: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "vdmbench needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Try: make PYTHON=python3.12"; exit 4; }
	@test -x .venv/bin/pip || $(PYTHON) -m venv .venv
	@echo "installing packages, some 300 MB:"
	$(PIP) --editable .
	@touch $@

# what tests and documents need besides
.venv/ready: .venv/installed
	$(PIP) --quiet --editable '.[test]'
	@touch $@

# the shared libraries that the gmsh and VTK wheels expect from the system, and Debian's packages of them
PROBE := import ctypes, importlib.util; \
  wanted = {"libgomp.so.1": "libgomp1", "libGLU.so.1": "libglu1-mesa", "libXft.so.2": "libxft2", \
            "libXcursor.so.1": "libxcursor1", "libXinerama.so.1": "libxinerama1", "libGL.so.1": "libgl1"}; \
  missing = [] if importlib.util.find_spec("ensurepip") else ["python3-venv"]; \
  loads = lambda name: bool(ctypes.CDLL(name)); \
  exec("for name, package in wanted.items():\n try: loads(name)\n except OSError: missing.append(package)"); \
  print(" ".join(missing))

libraries:
	@missing="$$($(PYTHON) -c '$(PROBE)')" || exit 4; \
	test -z "$$missing" && exit 0; \
	echo "installing $$missing"; \
	if ! command -v apt-get >/dev/null; then :; \
	elif [ "$$(id -u)" = 0 ]; then apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get install -y -qq $$missing && exit 0; \
	elif sudo -n true 2>/dev/null; then sudo apt-get update -qq && sudo apt-get install -y -qq $$missing && exit 0; fi; \
	echo "please install, then try again: apt-get install $$missing"; exit 4

clean:
	rm -rf .venv build *.egg-info results/runs results/cache .pytest_cache .mypy_cache .ruff_cache .hypothesis
