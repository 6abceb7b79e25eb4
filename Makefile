# make demo   the quickstart study and its report
# make test   what continuous integration runs
# make verify the long verification runs; their table goes to results/verification.md
# Each sets up what it needs: .venv, pinned packages, and the shared libraries of gmsh and VTK.

PYTHON ?= python3
RUN := .venv/bin/
PYTEST := OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m pytest

.PHONY: demo test verify docs baselines accuracy candidates claims calibrations stability setup libraries clean
.PHONY: bench-vdm bench-fem bench-baseline performance error-bars

demo: setup
	$(RUN)vdmbench run quickstart

test: setup
	$(RUN)ruff check .
	$(RUN)ruff format --check .
	@mkdir -p build/typed && ln -sfn ../../studies build/typed/vdmbench
	$(RUN)mypy
	$(PYTEST) -n $$(nproc) --dist loadfile -m "not slow" --timeout 600 --timeout-method thread

verify: setup
	$(PYTEST) --verification

# the generated parts of the documents; SURFACE=liver.obj draws the README's picture with a real liver
docs: setup
	$(RUN)python -m tests.docs.regenerate $(SURFACE)

# the accuracy table of vdm/README.md, from the shipped accuracy studies; SURFACE=liver.obj adds a row
accuracy: setup
	$(RUN)python -m tests.docs.vdm_accuracy $(SURFACE)

# accepts the accuracy of the fast shipped studies as it is now: make baselines REASON="why it changed"
baselines: setup
	@test -n "$(REASON)" || { echo 'say why: make baselines REASON="..."'; exit 2; }
	for study in quickstart regression; do \
	  $(RUN)vdmbench run $$study && $(RUN)vdmbench accept results/runs/$$study --reason "$(REASON)" || exit 1; done

# the paper's claims on trial: results/gallery/claims.html, a picture of each, and the table in README.md
claims: setup
	$(RUN)python -m tests.docs.claims

# the studies of numerical stability, some minutes each, and the table of what breaks where in README.md
stability: setup
	$(RUN)python -m tests.docs.stability

# the fits of the surface models' parameters: results/calibrations.md
calibrations: setup
	$(RUN)python -m tests.docs.calibrations

# what a third mesh level says of the error bars of two: results/error-bars.md
error-bars: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.docs.error_bars

# the table of candidates of vdm/README.md, from the shipped calibration studies; SURFACE=liver.obj adds a column
candidates: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.docs.candidates $(SURFACE)

# what the surface model costs on this machine, in one thread; README=1 writes it into vdm/README.md too
bench-vdm: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.benchmarks.vdm_speed $(if $(README),--readme)

# what the linear finite elements cost, beside NGSolve and scikit-fem, in one thread
bench-fem: setup
	.venv/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[benchmark]'
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.benchmarks.fem_speed

# README's performance section and figure; SURFACE=liver.obj measures a third body. What is measured stays in
# results/bench/bench.h5: BENCH=results/bench/bench.h5 makes them from it again, without measuring
performance: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.docs.performance \
	  $(if $(SURFACE),--surface $(SURFACE)) $(if $(BENCH),--bench $(BENCH))

# the benchmark's machine-independent figures that the tests hold: look at the difference before committing it
bench-baseline: setup
	OMP_NUM_THREADS=1 OPENBLAS_NUM_THREADS=1 $(RUN)python -m tests.regression.test_bench

setup: libraries .venv/ready

.venv/ready: pyproject.toml constraints.txt
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || { \
	  echo "vdmbench needs Python 3.11 or newer; $(PYTHON) is $$($(PYTHON) --version 2>&1). Try: make PYTHON=python3.12"; exit 4; }
	@test -x .venv/bin/pip || $(PYTHON) -m venv .venv
	.venv/bin/pip install --quiet --disable-pip-version-check --constraint constraints.txt --editable '.[test]'
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
