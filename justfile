# Recipes for daily work; `just` lists them. Each is a thin wrapper: the scripts in ci/ work without just.

packages := "--workspace --exclude pskel-shaders"

# Lists the recipes.
default:
    @just --list

# Installs missing system packages (apt); without --yes only lists them.
setup *args:
    ci/setup.sh {{ args }}

# Builds the command in release mode.
build:
    cargo build --release --locked -p pskel

# Fast loop: unit tests of the core. Filters are parts of test names.
test-core *filters:
    cargo test --locked -p point-skeleton --lib -- {{ filters }}

# Tests of the whole workspace, by parts of their names.
test *filters:
    cargo test --locked {{ packages }} --no-fail-fast -- {{ filters }}

# Everything that CI runs (about 45 minutes on two cores).
ci:
    ci/test.sh

# Tests of the Python package, by pytest's -k expression and other arguments.
python *args:
    ci/python.sh {{ args }}

# Formats all Rust code.
fmt:
    cargo fmt --all

# Format, import cycles and lints.
lint:
    cargo fmt --all --check
    python3 ci/cycles.py
    cargo clippy {{ packages }} --all-targets --locked -- -D warnings

# API documentation.
doc:
    RUSTDOCFLAGS=-Dwarnings cargo doc {{ packages }} --no-deps --locked

# Checks the links of README and docs, and builds the book if mdbook is installed.
book:
    python3 ci/book.py

# From a log to a simulated rollout with images; without LOG, the synthetic town.
demo *log:
    ci/demo.sh {{ log }}

# Time per frame and per stage on a synthetic street.
bench *args:
    cargo bench --locked -p pskel-eval {{ args }}

# Hashes of what the command writes: two versions that print the same lines render the same maps.
golden shared="../shared": build
    python3 ci/golden.py target/release/pskel {{ shared }}

# Fuzzes all readers and protocols.
fuzz minutes="10" *targets:
    ci/fuzz.sh {{ minutes }} {{ targets }}

# Licenses, advisories and sources of the dependencies (cargo install cargo-deny).
deny:
    cargo deny check

# Spelling (cargo install typos-cli).
typos:
    typos
