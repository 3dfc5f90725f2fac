# `make demo` and `make test` do all the set-up: only python3 (>= 3.11, with pip), make and git are needed.
PY      ?= python3
UV_VER  := 0.13.9
UV      := .tools/bin/uv
V       := .venv
# One thread per process: on a small machine BLAS threads slow everything down.
export OPENBLAS_NUM_THREADS ?= 1
export UV_PYTHON_DOWNLOADS = never
# The machine's own certificates: a laboratory network may have its own authority.
export UV_SYSTEM_CERTS = 1
unexport PYTHONDONTWRITEBYTECODE
.PHONY: demo test check bench study blind fuzz mutants faults kills real-data pages lock clean

$(UV):
	@$(PY) -c 'import sys; sys.exit(sys.version_info < (3, 11) and "Python >= 3.11 needed, this is " + sys.version.split()[0])'
	@$(PY) -m pip install -qq --disable-pip-version-check --target .tools uv==$(UV_VER)

$(V)/.run: requirements-run.lock pyproject.toml | $(UV)
	@test -x $(V)/bin/python || $(UV) venv -q --python $(PY) $(V)
	@$(UV) pip install -q --python $(V)/bin/python --require-hashes -r requirements-run.lock
	@$(UV) pip install -q --python $(V)/bin/python --no-deps --no-build-isolation -e .
	@touch $@

$(V)/.dev: requirements.lock $(V)/.run
	@$(UV) pip install -q --python $(V)/bin/python --require-hashes -r requirements.lock
	@touch $@

demo: $(V)/.run ## the main job: a full sweep on the simulated bench
	@$(V)/bin/rig sweep --axis x

test: $(V)/.dev ## every test; with benches served beside, two cores have work for three
	@$(V)/bin/python -m pytest -n 3

check: $(V)/.dev ## style, types and import directions
	@$(V)/bin/ruff check .
	@$(V)/bin/ruff format --check .
	@$(V)/bin/mypy
	@$(V)/bin/lint-imports

$(V)/.oracle: requirements-bench.lock $(V)/.dev
	@$(UV) pip install -q --python $(V)/bin/python --require-hashes -r requirements-bench.lock
	@touch $@

bench: $(V)/.oracle ## the measured bars, printed as ratios
	@$(V)/bin/python -m pytest -q -s tests/benchmarks -o python_files='bench_*.py' -o timeout=1800 -p no:xdist

study: $(V)/.dev ## two hundred simulated worlds: how often the stated intervals hold the truth (RIG_SEEDS; ten minutes)
	@$(V)/bin/python -m pytest -q -s tests/benchmarks -o python_files='study_*.py' -o timeout=7200 -p no:xdist

$(V)/.peers: requirements-peers.lock $(V)/.dev
	@$(UV) pip install -q --python $(V)/bin/python --require-hashes -r requirements-peers.lock
	@touch $@

blind: $(V)/.dev $(if $(PEERS),$(V)/.peers) ## hidden effects, sealed answers, scores (N=30 is all; PEERS=1 WIRE=20 ONLY=one OUT=…; hours)
	@$(V)/bin/python tests/benchmarks/blind.py --worlds $(or $(N),30) --out $(or $(OUT),runs/blind) $(if $(PEERS),--peers --page docs/blind_test.md) $(if $(WIRE),--wire $(WIRE)) $(if $(SERIES),--series $(SERIES)) $(foreach table,$(ONLY),--only $(table))

fuzz: $(V)/.dev ## every reader of what comes from outside, with inputs that are nearly right (N=100000 ONLY=… SEED=…; five minutes)
	@$(V)/bin/python tests/fuzz.py --inputs $(or $(N),100000) --seed $(or $(SEED),0) $(if $(ONLY),--only "$(ONLY)")

mutants: $(V)/.dev ## faults planted where promises of safety and durability are kept: tests must notice (ten minutes)
	@$(V)/bin/python tests/mutants.py

faults: $(V)/.dev ## every fault of a bench that we know, and docs/reference/faults.md (OUT=… JOBS=2 ONLY=…; goes on where it was; half an hour)
	@$(V)/bin/python tests/fault_matrix.py --out $(or $(OUT),runs/faults) --jobs $(or $(JOBS),2) $(if $(ONLY),--only "$(ONLY)")

kills: $(V)/.dev ## commands killed at every touch of the file system or at random (N=100), and a thousand power cuts (twenty minutes)
	@$(V)/bin/python tests/crash_points.py
	@$(V)/bin/python tests/random_kills.py $(or $(N),100)
	@RIG_CUTS=500 $(V)/bin/python -m pytest -q tests/test_power_cuts.py

real-data: $(V)/.dev ## docs/real-data.md from other people's measurements (DATA=FOLDER, default ../shared/data; five minutes)
	@$(V)/bin/python tests/real_data.py --data $(or $(DATA),../shared/data)

pages: $(V)/.dev ## commands, effects and schemas under docs/reference, from the code
	@env -u RIG_EFFECTS $(V)/bin/python tests/pages.py

lock: $(UV) ## renew the hashed locks (names no registry)
	@$(UV) lock -q
	@$(UV) export -q --format requirements.txt --no-emit-project --no-header --no-annotate --no-dev --group build > requirements-run.lock
	@$(UV) export -q --format requirements.txt --no-emit-project --no-header --no-annotate --group build > requirements.lock
	@$(UV) export -q --format requirements.txt --no-emit-project --no-header --no-annotate --group build --group oracle > requirements-bench.lock
	@$(UV) export -q --format requirements.txt --no-emit-project --no-header --no-annotate --group build --group peers > requirements-peers.lock

clean:
	@rm -rf .venv .tools runs .pytest_cache .mypy_cache .ruff_cache
