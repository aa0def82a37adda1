# `make` lists the targets. PYTHON=/path/to/python3 chooses the interpreter of a new .venv.

SHELL := /bin/sh
MAKEFLAGS += --no-print-directory
.DEFAULT_GOAL := help
# Each process would compile every module anew: a third of the time of `make test`.
unexport PYTHONDONTWRITEBYTECODE

# Those with wheels of both engines first, and of them the one that the figures of docs/ come from.
VERSIONS := 3.11 3.12 3.13 3.10
PYTHONS := $(or $(PYTHON), $(VERSIONS:%=python%) python3 python \
	$(foreach version,$(VERSIONS) 3,$(wildcard $(HOME)/.pyenv/versions/$(version).*/bin/python)))
IS_SUITABLE := sys.exit(sys.version_info < (3, 10))
# One that can make .venv comes before one that lacks a package of Debian for that.
FIND_PYTHON = for modules in "sys, ensurepip, venv" sys; do \
		for python in $(PYTHONS); do \
			if $$python -c "import $$modules; $(IS_SUITABLE)" 2>/dev/null; then break 2; fi; python=; \
		done; \
	done; \
	if [ -z "$$python" ]; then \
		echo "no Python from 3.10 on found; install one, or name it: make PYTHON=/path/to/python3" >&2; \
		exit 1; \
	fi

BIN := .venv/bin
PIP := $(BIN)/python -m pip --disable-pip-version-check --no-input
DEMO_STAMP := .venv/.demo-done
STAMP := .venv/.setup-done
MAKE_VENV = if ! $(BIN)/python -c "import sys; $(IS_SUITABLE)" 2>/dev/null; then \
		$(FIND_PYTHON); \
		version=$$($$python -c 'import sys; print("%d.%d" % sys.version_info[:2])') && \
		{ $$python -c 'import ensurepip, venv' 2>/dev/null || \
			sh .ci/need python$$version-venv; } && \
		$$python -m venv --clear .venv; \
	fi

.PHONY: help setup demo test browser smoke release long short lint fmt types imports schemas docs site docs-media bench house chaos fuzz mutants pins \
	interop interop-short interop-build interpreters ci clean packages wheel wheel-tests platforms notice image sizes

help: ## list the targets
	@sed -n 's/^\([a-z-]*\):.*## \(.*\)/  make \1\t\2/p' Makefile | expand -t 18

setup: $(STAMP) ## make .venv with everything that the demo and the tests need

$(STAMP): pyproject.toml requirements/dev.txt
	@$(MAKE_VENV)
	$(PIP) install -q --require-hashes -r requirements/dev.txt
	@rm -rf zensim.egg-info # what an older build left would be read instead of the new metadata
	$(PIP) install -q --no-deps --no-build-isolation -e .
	@touch $(DEMO_STAMP) $@

# Without byte code: most modules of the packages are not imported.
$(DEMO_STAMP): pyproject.toml requirements/demo.txt requirements/build.txt
	@$(MAKE_VENV)
	$(PIP) install -q --no-compile --require-hashes -r requirements/demo.txt -r requirements/build.txt
	@rm -rf zensim.egg-info # as above
	$(PIP) install -q --no-deps --no-build-isolation -e .
	@touch $@

demo: $(DEMO_STAMP) ## ten robots in one world, and the address of the page that shows them
	$(BIN)/zensim up

packages: # Debian packages that the tests use
	@sh .ci/need chromium=chromium,chromium-browser,google-chrome iproute2=ip strace=strace \
		systemd=systemd-analyze nodejs=node npm=npm openssl=openssl mosquitto=mosquitto libegl1 libgl1-mesa-dri
	@sh .ci/promtool >/dev/null

# Side by side, but those of a file one after another: they share a server. Tests of processes often
# wait, so there is one worker more than cores; tests/conftest.py mixes them with those that compute.
# Up to five that fail run again, alone, and are named at the end: CONTRIBUTING.md.
WORKERS ?= $$(($$(getconf _NPROCESSORS_ONLN) + 1))
PYTEST := $(BIN)/python .ci/run_tests.py -n $(WORKERS) --dist loadfile --no-loadscope-reorder

# Without the tests that other targets run.
HERE := not release and not short_form and not long_form and not interop and not images

test: setup packages ## all tests but those of `make browser`, `make release` and `make short`
	@if [ "$$(id -u)" = 0 ]; then $(PYTEST) -m "not browser and $(HERE)"; \
	elif ! command -v sudo >/dev/null; then \
		echo "tests of network namespaces need root, and there is no sudo; run make test as root" >&2; \
		exit 1; \
	else $(PYTEST) -m "not root and not browser and $(HERE)" && \
		sudo $(BIN)/python -B .ci/run_tests.py -p no:cacheprovider -m "root and $(HERE)"; \
	fi

browser: setup packages ## tests of the page in Chromium
	$(PYTEST) -m "browser and $(HERE)"

smoke: setup packages ## of `make browser`, what CI runs for each push
	$(PYTEST) -m "browser and smoke and $(HERE)"

release: setup packages ## tests of tools, documents and whole programs; CI runs them nightly
	$(PYTEST) -m "release and not root and not browser and not short_form and not long_form and not interop and not images"

long: setup packages ## further cases of tests of `make test` and `make browser`, and long ones; as root
	$(PYTEST) -m long_form

short: setup packages ## short forms of `make bench`, `make chaos` and `make fuzz`
	$(PYTEST) --dist load --maxschedchunk 1 -m short_form

lint: setup ## style of the code, and dead code
	$(BIN)/ruff check
	$(BIN)/ruff format --check
	$(BIN)/vulture

fmt: setup ## format the code and mend what can be mended
	$(BIN)/ruff check --fix
	$(BIN)/ruff format

types: setup ## types of the code and of the tests
	$(BIN)/mypy

imports: setup ## which module may import which
	$(BIN)/lint-imports

schemas: setup ## committed schemas against the messages
	$(BIN)/python -m zensim.proto.schema --check

docs: setup ## links, commands and change log of the documents
	$(BIN)/python -m pytest -q tests/contract/test_docs.py

site: setup ## build/site: the documents as a site
	NO_MKDOCS_2_WARNING=1 $(BIN)/mkdocs build -q -f .mkdocs.yml

docs-media: setup packages ## pictures and film of the page in docs/images
	$(BIN)/python -m tests.integration.docs_media

bench: setup ## measure and rewrite docs/benchmark_results.md and docs/benchmarks.md
	$(BIN)/python -m benchmarks
	$(BIN)/python -m benchmarks.overview_page

house: setup ## figures of the source tree: files, lines, repeated names, files of a flow
	$(BIN)/python -m benchmarks.house

chaos: setup packages ## kill, stop and starve, at full length, and rewrite docs/chaos.md
	$(BIN)/python -m tests.chaos

fuzz: setup ## damaged input for every reader and for servers with each engine, and property tests
	$(BIN)/python -m tests.hostile.fuzz
	$(BIN)/python -m tests.hostile.server_fuzz
	$(BIN)/python -m tests.hostile.message_fuzz
	for reader in messages descriptions meshes; do \
		$(BIN)/python -m tests.hostile.coverage_fuzz $$reader || exit 1; \
	done
	$(BIN)/python -m pytest -n auto -m hypothesis --hypothesis-profile=fuzz --timeout=900

interop: setup ## ROS 2 peers that share no code with zensim, and rewrite docs/interop.md; needs cargo
	$(BIN)/python -m tests.interop

interop-short: setup ## a minute of them, and some more for the first build
	$(BIN)/python -m tests.interop --short

interop-build: setup # what interop-short runs
	@$(BIN)/python -m tests.interop --short --build

interpreters: ## demo and both engines with each Python from 3.10 to 3.14 that is here; CI: the newest
	sh .ci/interpreters

mutants: setup packages ## change the code in 100 places, and print the changes that no test notices
	$(BIN)/python -m tests.mutation

wheel: setup ## dist/: the wheel of the last commit, built twice with equal bytes, and its SBOM
	@sh .ci/wheel

wheel-tests: setup packages ## tests on the wheel of `make wheel`, in a new environment without the source
	@sh .ci/test_wheel

platforms: setup ## whether each platform has wheels of all packages; needs an index of packages
	@sh .ci/platforms

TARGETS := agent server full
image: setup ## build and try the images of deploy/containers, as root and without a daemon
	sh .ci/image $(TARGETS)
	IMAGES="$(TARGETS)" $(BIN)/python -m pytest -m images -p no:cacheprovider tests/integration/test_images.py

notice: setup ## write NOTICE: licences of all packages that an extra installs
	$(BIN)/python .ci/notices.py >NOTICE

sizes: setup ## packages and size on disk of each extra, as in docs/packages.md
	@$(BIN)/python .ci/sizes.py

pins: ## resolve requirements/ anew
	@$(FIND_PYTHON); $$python -m venv build/pins
	build/pins/bin/python -m pip --disable-pip-version-check install -q uv
	@set -e; for name in dev server demo all cameras viewer xacro foxglove vda5050 dataset plot top rl ray metrics base; do \
		case $$name in \
			dev) choice="--all-extras" ;; \
			base) choice="-c requirements/dev.txt" ;; \
			demo) choice="-c requirements/dev.txt --extra server --extra viewer --extra xacro" ;; \
			*) choice="-c requirements/dev.txt --extra $$name" ;; \
		esac; \
		build/pins/bin/uv pip compile -q pyproject.toml $$choice --universal --python-version 3.10 \
			--generate-hashes --no-strip-extras --no-emit-index-url --no-annotate --custom-compile-command "make pins" \
			-o requirements/$$name.txt; \
	done
	echo 'setuptools>=77' | build/pins/bin/uv pip compile -q - -c requirements/dev.txt --universal \
		--python-version 3.10 --generate-hashes --no-emit-index-url --no-annotate --custom-compile-command "make pins" \
		-o requirements/build.txt
	echo ir-sim | build/pins/bin/uv pip compile -q - --universal --python-version 3.10 --generate-hashes \
		--no-emit-index-url --no-annotate --custom-compile-command "make pins" -o requirements/peers.txt

ci: ## what CI runs
	@bash .ci/run

clean: ## remove .venv and everything that was made
	rm -rf .venv build dist *.egg-info .mypy_cache .pytest_cache .ruff_cache .hypothesis \
		.import_linter_cache .coverage
	find . -name __pycache__ -type d -prune -exec rm -rf {} +
