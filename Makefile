# Needs Python 3.10-3.13, make and a package registry; everything else goes into .venv.
PYTHON ?= python3
VENV   := .venv
BIN    := $(VENV)/bin
STAMP  := $(VENV)/.installed
BENCH_STAMP := $(VENV)/.bench-installed
DOCS_STAMP := $(VENV)/.docs-installed
WEB    := server/web
PAGE   := $(WEB)/dist/index.html
PAGE_SOURCES = $(shell find $(WEB) -path $(WEB)/node_modules -prune -o -path $(WEB)/dist -prune -o -type f -print)
PARALLEL := -n 2 --dist loadfile --no-loadscope-reorder
# Node.js, which builds the page, comes as a package, too
export PATH := $(abspath $(BIN)):$(PATH)
ADDON := dist/chamfer_morph_blender.zip
BLENDER := $(VENV)/blender/bin/python
export CONTAINER_ENGINE ?= $(if $(shell command -v docker),docker,podman)
CHROMIUM := $(or $(MORPH_CHROMIUM),$(shell command -v chromium))

.DEFAULT_GOAL := help
.PHONY: help install demo page site test test-acceptance test-browser test-site test-faults test-distribution \
  test-blender addon image test-image audit sbom mutation lint \
  format bench gallery pictures lock clean

help:  ## show the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' $(MAKEFILE_LIST) | expand -t 21

install: $(STAMP)  ## build .venv with the locked packages and the `morph` command

$(STAMP): requirements.lock pyproject.toml
	@$(PYTHON) -c 'import sys; ok = (3, 10) <= sys.version_info[:2] <= (3, 13); \
	ok or sys.exit("This project needs Python 3.10-3.13, and $(PYTHON) is %d.%d. Choose another: make PYTHON=python3.12" % sys.version_info[:2])'
	$(PYTHON) -m venv $(VENV)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements.lock
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --no-deps --no-build-isolation -e .
	@touch $@

demo: install  ## start the service, submit a morph, show its progress, fetch and print the result
	$(BIN)/python examples/service_demo.py

test: install  ## the library and the service, under 10 minutes on 2 cores
	$(BIN)/python -m pytest $(PARALLEL) tests/integration tests/unit

test-acceptance: install  ## commands, workers and engines in processes of their own; 7 minutes
	$(BIN)/python -m pytest $(PARALLEL) tests/acceptance

page: install $(PAGE)  ## build the web page

$(PAGE): $(WEB)/node_modules/.package-lock.json $(PAGE_SOURCES)
	cd $(WEB) && npm run build
	@touch $@

$(WEB)/node_modules/.package-lock.json: $(WEB)/package.json $(WEB)/package-lock.json
	cd $(WEB) && npm ci
	@touch $@

test-browser: install page  ## the web page in headless Chromium, against the real service
	@test -n "$(CHROMIUM)" || { echo "There is no chromium here: apt-get install chromium, or name one in MORPH_CHROMIUM."; exit 2; }
	$(BIN)/python -m pytest $(PARALLEL) -m browser tests/browser

site: install $(DOCS_STAMP)  ## the documentation as a site, in the folder site; Python 3.11 or newer
	rm -rf site
	$(BIN)/python -m docs.site --to site

$(DOCS_STAMP): requirements-docs.lock $(STAMP)
	@$(BIN)/python -c 'import sys; sys.version_info >= (3, 11) or sys.exit("The site needs Python 3.11 or newer: make clean, then make site PYTHON=python3.12.")'
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-docs.lock
	@touch $@

test-site: site  ## its links, its examples, and its pages in headless Chromium
	@test -n "$(CHROMIUM)" || { echo "There is no chromium here: apt-get install chromium, or name one in MORPH_CHROMIUM."; exit 2; }
	$(BIN)/python -m pytest -m site tests/site tests/acceptance/test_documented_examples.py

test-faults: install  ## kill, stop, cut and corrupt what runs, on SQLite and Postgres; long
	$(BIN)/python -m pytest -m faults

test-distribution: install page  ## the wheel on each Python of 3.10-3.13 that is here
	$(BIN)/python -m pytest -m distribution

$(ADDON): $(wildcard blender/*)
	@mkdir -p dist
	rm -f $@ && cd blender && ../$(BIN)/python -m zipfile -c ../$@ *.py blender_manifest.toml

addon: install $(ADDON)  ## the Blender add-on as a zip in dist

$(BLENDER):
	$(PYTHON) -m venv $(VENV)/blender
	$(VENV)/blender/bin/python -m pip install --quiet --disable-pip-version-check bpy==4.2.0

test-blender: addon $(BLENDER)  ## add-on, animated GLB and point caches in Blender 4.2, which has to be fetched: 500 MB; Python 3.11
	MORPH_BLENDER=$(abspath $(BLENDER)) MORPH_ADDON=$(abspath $(ADDON)) $(BIN)/python -m pytest -m blender

image:  ## the container image `morph` on Debian's BASE, by docker or podman; IMAGE_OPTIONS are of their `build`
	@test -n "$(BASE)" || { echo "Which base? make image BASE=debian@sha256:...; docs/operating.md tells how to find the digest."; exit 2; }
	$(CONTAINER_ENGINE) build --build-arg BASE=$(BASE) $(if $(findstring podman,$(CONTAINER_ENGINE)),--format docker) $(IMAGE_OPTIONS) \
	  --tag morph --file docker/Dockerfile .

test-image: install image  ## a job, MP4 and USD in the image, as a non-root user, on a read-only root
	$(BIN)/python -m pytest -m image

lint: install  ## style, types and import contracts
	$(BIN)/ruff check .
	$(BIN)/ruff format --check .
	$(BIN)/mypy
	$(BIN)/lint-imports

format: install  ## rewrite the code in the project's style
	$(BIN)/ruff check --fix .
	$(BIN)/ruff format .

bench: install $(BENCH_STAMP)  ## speed against peers measured in the same run
	$(BIN)/python -m benchmarks

$(BENCH_STAMP): requirements-bench.lock $(STAMP)
	$(BIN)/python -m pip install --quiet --disable-pip-version-check --require-hashes --no-deps -r requirements-bench.lock
	@touch $@

lock:  ## resolve the versions again (needs uv)
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra dev -o requirements.lock pyproject.toml
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra bench -c requirements.lock -o requirements-bench.lock pyproject.toml
	uv pip compile --universal --python-version 3.10 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra docs -c requirements.lock -o requirements-docs.lock pyproject.toml
	uv pip compile --python-platform linux --python-version 3.13 --generate-hashes --no-emit-index-url \
	  --no-header --upgrade --extra all -c requirements.lock \
	  -o requirements-image.lock pyproject.toml

mutation: install  ## faults planted into the queue, one at a time; hours; FILES are some of its files
	$(BIN)/python -m benchmarks.mutation $(FILES)

audit: install  ## known weaknesses of the locked packages, by pip-audit; asks PyPI
	for lock in requirements-image.lock requirements.lock; do \
	  $(BIN)/uv tool run pip-audit --strict --require-hashes --disable-pip -r $$lock || exit 1; done

sbom: install  ## what the image has of Python, as CycloneDX in dist/sbom.json
	@mkdir -p dist
	$(BIN)/uv tool run --from cyclonedx-bom cyclonedx-py requirements requirements-image.lock -o dist/sbom.json

gallery: install  ## twelve morphs in GALLERY (the folder gallery): results, a sheet, videos
	$(BIN)/python -m docs.pictures gallery --to "$(or $(GALLERY),gallery)"

pictures: install page  ## make the pictures of the documentation again; needs MORPH_MESHES
	$(BIN)/python -m docs.pictures --meshes "$(MORPH_MESHES)"

clean:  ## remove .venv and caches
	rm -rf demo-data site $(VENV) $(WEB)/dist $(WEB)/node_modules build dist .mypy_cache .ruff_cache .pytest_cache .hypothesis .import_linter_cache
