# A developer's loop, in the environment .venv if there is one: make check
BIN := $(if $(wildcard .venv/bin),.venv/bin/)
TESTS ?= tests/unit

.PHONY: check lint types test
check: lint types test

lint:
	$(BIN)ruff check .
	$(BIN)ruff format --check .
	$(BIN)lint-imports --no-cache

types:
	$(BIN)mypy

# Of one file or folder: make test TESTS=tests/unit/kernel
test:
	$(BIN)pytest $(TESTS)
