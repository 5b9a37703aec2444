# Everything a newcomer needs; each target first makes the environment in .venv.
# Needs make and Python 3.11; `make PYTHON=/path/to/python` chooses another one.

MAKEFLAGS += --no-print-directory
SHELL := /bin/sh
# Images of containers often forbid byte code: every process of the tests would compile all modules again.
unexport PYTHONDONTWRITEBYTECODE
PYTHON ?= $(firstword $(foreach name,python3.11 python3 python,$(shell \
	$(name) -c 'import sys; sys.version_info >= (3, 11) and print("$(name)")' 2>/dev/null)))
RUN := .venv/bin/python -m
JOBS ?= 2
# Real images with boxed signs, where they are at hand; the networks are not trained without.
REAL ?= $(wildcard ../shared/data/real)

.PHONY: help demo test slow check site wiring accept held-out drives learning-drives learn learn-networks learn-faces learn-posts clean
help:
	@echo 'make demo     find the signs of the recorded drive and compare them with the truth'
	@echo 'make test     run the fast tests, in two processes'
	@echo 'make slow     run the tests marked slow: learning, statistics over many drives'
	@echo 'make wiring   leave every stage and model out of the flow, one at a time; a test must fail each time'
	@echo 'make check    lint, format, types, layers, marks of a merge'
	@echo 'make site     build the documentation site in out/site; needs no network once its packages are installed'
	@echo 'make accept   measure recall, precision and accuracy on rendered drives; fails below the floor'
	@echo 'make held-out measure the same on drives that no model was learned from; writes a table'
	@echo 'make drives   render all drives into .cache/drives'
	@echo 'make learn    learn the models from the rendered drives'
	@echo 'make learn-networks train the detection network and the box network: long, resumable'
	@echo 'make learn-faces    learn the face classifier from drawings and crops: minutes'
	@echo 'make learn-posts    learn the kinds of posts from rendered drives with posts that vary'
	@echo 'make clean    remove results and tool caches; keeps .venv and the rendered drives'

demo: .venv/.ready
	@.venv/bin/wayside run recordings/demo.mcap --view file -o out/demo
	@echo
	@.venv/bin/wayside evaluate out/demo --truth recordings/demo.truth.json
	@echo
	@echo 'next: .venv/bin/wayside view out/demo      opens the recording of every step (--serve: in a browser)'

# Threads of the learning libraries wait for each other longer than they work on samples as small as those of tests.
TEST := OMP_NUM_THREADS=1 $(RUN) pytest -q --numprocesses $(JOBS) --dist loadscope --no-loadscope-reorder
test: .venv/.ready
	@$(TEST)

slow: .venv/.ready
	@$(TEST) -m slow

wiring: .venv/.ready
	@OMP_NUM_THREADS=1 .venv/bin/python tests/wiring.py --jobs $(JOBS)

check: .venv/.ready
	@$(RUN) ruff check
	@$(RUN) ruff format --check
	@$(RUN) mypy
	@.venv/bin/lint-imports
	@.venv/bin/python tests/ceilings.py
	@! git grep -nE '^(<<<<<<<|>>>>>>>)( |$$)' || { echo 'wanted files without marks of a merge, found these; keep one side' >&2; exit 1; }

site: .venv/.site
	@.venv/bin/python docs/make_site.py .cache/site
	@NO_MKDOCS_2_WARNING=1 $(RUN) mkdocs build --quiet --strict
	@echo 'open out/site/index.html'

accept: .venv/.ready
	@.venv/bin/python benchmarks/accept.py --jobs $(JOBS)

held-out: .venv/.ready
	@.venv/bin/python benchmarks/held_out.py --jobs $(JOBS)

drives: .venv/.ready
	@$(RUN) recordings.drives recordings/drives/specs/*.toml -o .cache/drives --missing --masks --jobs $(JOBS)

learning-drives: .venv/.ready
	@$(RUN) recordings.drives recordings/drives/specs/learn_*.toml -o .cache/drives --missing --jobs $(JOBS)

# Landmarks are learned from other drives than the detectors that find them: the same specifications with other seeds.
AGAIN := .cache/drives/again
# A folder of its own, which begins as a copy of the models that ship: each step finds there what those before it wrote.
LEARNED := .cache/models
learn: learning-drives
	@rm -rf $(LEARNED) && mkdir -p $(LEARNED) && cp pipeline/models/*.json pipeline/models/*.onnx $(LEARNED)
	@OMP_NUM_THREADS=1 $(RUN) training.learn --drives .cache/drives -o $(LEARNED)
	@$(RUN) recordings.drives recordings/drives/specs/learn_*.toml -o $(AGAIN) --reseed 70000 --frames 44 --missing --jobs $(JOBS)
	@$(RUN) training.box_thresholds --drives $(AGAIN) -o $(LEARNED)
	@$(RUN) training.learn_landmarks --drives $(AGAIN) $(if $(REAL),--real $(REAL) --without benchmarks/models_without) -o $(LEARNED)
	@cp $(LEARNED)/*.json $(LEARNED)/*.onnx pipeline/models
	@cd pipeline/models && sha256sum *.json *.onnx > SHA256SUMS

# Minutes on an accelerator with many cores, most of a day on two; it can be interrupted, and goes on from its checkpoint.
# WITHOUT=SOURCE trains networks that never see a source of real pictures, in a folder of their own.
# After it: thresholds and landmark classifiers, which `make learn` learns.
NETWORK_STEPS ?= 22000
learn-networks: learning-drives .venv/.learn
	@test -n "$(REAL)" || { echo 'wanted REAL=FOLDER of real pictures, found none' >&2; exit 2; }
	@OMP_NUM_THREADS=1 $(RUN) training.network_training --drives .cache/drives --real $(REAL) --steps $(NETWORK_STEPS) \
		-o .cache/networks$(WITHOUT:%=_without_%) $(WITHOUT:%=--without %)

learn-faces: .venv/.learn
	@test -n "$(REAL)" || { echo 'wanted REAL=FOLDER of real pictures, found none' >&2; exit 2; }
	@OMP_NUM_THREADS=1 $(RUN) training.face_codes --real $(REAL) -o pipeline/models
	@cd pipeline/models && sha256sum *.json *.onnx > SHA256SUMS

POSTS := alley arcade bazaar causeway compact crossing europe forest freeway glint grove highway orbital overcast prairie street sunset tramway village whimsy
learn-posts: .venv/.ready
	@$(RUN) recordings.drives $(POSTS:%=learn_%) -o .cache/drives/posts --reseed 130000 --frames 24 --varied-posts 8 --missing --jobs $(JOBS)
	@OMP_NUM_THREADS=1 $(RUN) training.learn_posts --drives .cache/drives/posts -o pipeline/models
	@cd pipeline/models && sha256sum *.json *.onnx > SHA256SUMS

clean:
	@rm -rf out build dist .mypy_cache .pytest_cache .ruff_cache .hypothesis .import_linter_cache

.venv/.ready: pyproject.toml setup.py requirements.lock
	@test -n "$(PYTHON)" || { echo 'wanted Python 3.11 or newer, found none; install it or say make PYTHON=/path/to/python' >&2; exit 2; }
	@echo 'making the environment in .venv (once)'
	@$(PYTHON) -m venv .venv
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check -r requirements.lock
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation --editable .
	@ln -sfn ../pipeline ../schemas ../stages wayside/
	@scratch=$$(mktemp -d) && for preset in default report report-2d report-shape; do \
		.venv/bin/wayside run recordings/demo.mcap --preset $$preset -o $$scratch/$$preset >/dev/null || exit 1; \
	done && rm -r $$scratch  # compiles every kernel, so that no run waits for it later
	@touch $@

.venv/.site: requirements-site.lock .venv/.ready
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -r requirements-site.lock
	@touch $@

# PyTorch is large and only the learning needs it.
.venv/.learn: requirements-learn.lock .venv/.ready
	@.venv/bin/python -m pip install --quiet --disable-pip-version-check -c requirements.lock -r requirements-learn.lock
	@touch $@
