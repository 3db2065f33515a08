# Two commands do everything: `make ladder` and `make test`. Both set up .venv on their first call
# and whenever pyproject.toml has changed.

PYTHON ?= python3
VENV := .venv

# Where this is set, as images of containers do, every process compiles anew all that it imports.
export PYTHONDONTWRITEBYTECODE =

READY := $(VENV)/.ready

.PHONY: ladder paper test test-all test-gpu check docs docs-run picture tiny hostile lock locked audit sbom mutate faults setup

ladder: $(READY)
	$(VENV)/bin/vidphys ladder --preset quick --out runs/ladder-quick

# The whole study: ten seeds, every rung whose weights are here, every table. Says first what it
# will cost; what it is asked again it does not do again. make paper DEVICE=cuda WORKERS=8
DEVICE ?= cpu
WORKERS ?= 2
ENGINE ?= local
STUDY = --preset paper --seed 100 --workers $(WORKERS) --device $(DEVICE)
paper: $(READY)
	$(VENV)/bin/vidphys plan ladder $(STUDY) --cells all
	$(VENV)/bin/vidphys plan reproduce all pixels $(STUDY)
	$(VENV)/bin/vidphys ladder $(STUDY) --engine $(ENGINE) --cells all --out runs/paper-ladder
	$(VENV)/bin/vidphys reproduce all pixels $(STUDY) --engine $(ENGINE) --out runs/paper-tables

TESTS = OPENBLAS_NUM_THREADS=1 $(VENV)/bin/python -m pytest -n 3

# What only a card can show; each test is skipped where there is none.
test-gpu: $(READY)
	$(VENV)/bin/python -m pytest tests/gpu -m gpu -rs

test: $(READY)
	$(TESTS) -m "not slow"

# Those marked slow as well, an hour or more on two cores: other cases of what the others show.
test-all: $(READY)
	$(TESTS)

check: $(READY)
	$(VENV)/bin/ruff check .
	$(VENV)/bin/ruff format --check .
	$(VENV)/bin/mypy
	$(VENV)/bin/lint-imports
	$(VENV)/bin/deptry .

# The site, into build/site, with no broken link; read by opening its index.html.
docs: $(READY)
	$(VENV)/bin/mkdocs build --strict

# The picture of the README: one rung at the quick preset, two minutes.
picture: $(READY)
	$(VENV)/bin/vidphys ladder --cells anonymous-tracker/factored --out runs/picture
	rm -f docs/ladder.png
	$(VENV)/bin/vidphys view runs/picture --movie docs/ladder.png

# The figure and the table of the model cards: what training adds to the tiny encoders, a quarter of an hour.
TINY = dino-tiny videomae-tiny vjepa2-tiny
tiny: $(READY)
	$(VENV)/bin/vidphys render --scene gravity-and-coulomb --world rgb --clips 300 --frames 16 --image 64 --seed 100 --out runs/tiny/clips
	$(VENV)/bin/vidphys atlas runs/tiny/clips --encoders $(TINY) $(TINY:=-attraction) --targets position direction velocity speed --seed 100 --store runs/tiny/features --out runs/tiny/atlas
	$(VENV)/bin/python -m vidphys.pretraining.figure runs/tiny/atlas --out docs/tiny-encoders.svg

# Every command of README and docs, at sizes that one can wait for; `make test` runs the short pages.
docs-run: $(READY)
	VIDPHYS_DOCS=whole $(VENV)/bin/python -m pytest tests/project/test_pages.py --durations 12

# Thousands of hurt files of every kind that is read: each is read, or refused in one line.
hostile: $(READY)
	$(VENV)/bin/python -m tests.hostile.mutants --count 5500
	$(VENV)/bin/python -m tests.hostile.mutants --count 500 --clips

# What a development environment consists of, to the byte; `make locked` installs just that.
lock: $(READY)
	$(VENV)/bin/uv pip compile --quiet pyproject.toml --extra test --universal --upgrade \
	  --python-version 3.11 --generate-hashes --no-emit-index-url --no-annotate \
	  --custom-compile-command "make lock" --output-file requirements.lock

locked: $(READY)
	$(VENV)/bin/uv pip install --python $(VENV)/bin/python --require-hashes -r requirements.lock

# Known holes in what is locked (asks the index, so it needs the network); what is installed.
audit: $(READY)
	$(VENV)/bin/uv tool run pip-audit --require-hashes --disable-pip -r requirements.lock

sbom: $(READY)
	$(VENV)/bin/cyclonedx-py environment $(VENV)/bin/python --output-file sbom.json

# Whether the tests would notice: tolerances tightened, signs and decisions turned round.
mutate: $(READY)
	$(VENV)/bin/python -m tests.mutation --out runs/mutation.json

# Kills, full disks, power cuts and damaged files, in the long versions: an hour on two cores.
faults: $(READY)
	VIDPHYS_FAULTS=100 $(VENV)/bin/python -m pytest tests/faults --timeout 7200

setup: $(READY)

# A changed pyproject.toml rebuilds the environment from nothing; uv only speeds the download.
$(READY): pyproject.toml tests/foreign/pyproject.toml
	@$(PYTHON) -c 'import sys; sys.exit(sys.version_info < (3, 11))' || \
	  { echo "error: $(PYTHON) is older than 3.11; call make with PYTHON=python3.11 or newer"; exit 2; }
	@$(PYTHON) -c 'import ensurepip' || \
	  { echo "error: $(PYTHON) has no venv module; on Debian: apt-get install python3-venv"; exit 2; }
	rm -rf $(VENV)
	$(PYTHON) -m venv $(VENV)
	$(VENV)/bin/python -m pip install --quiet uv
	$(VENV)/bin/uv pip install --quiet --python $(VENV)/bin/python --editable ".[test]"
	$(VENV)/bin/uv pip install --quiet --python $(VENV)/bin/python --no-deps --editable tests/foreign
	touch $(READY)
