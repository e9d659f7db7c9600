# Recipes for daily work; `just` lists them. Each is a thin wrapper: the scripts in ci/ work without just.

packages := "--workspace --exclude pskel-shaders"

# Lists the recipes.
default:
    @just --list

# Lists missing system packages; --yes installs them with apt.
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

# Everything: what CI runs on every change.
ci:
    ci/test.sh

# Tests of the Python package, by pytest's -k expression and other arguments.
python *args:
    ci/python.sh {{ args }}

# Formats all Rust code.
fmt:
    cargo fmt --all

# Format, import cycles, README and lints.
lint:
    cargo fmt --all --check
    python3 ci/cycles.py
    python3 ci/readme.py
    cargo clippy {{ packages }} --all-targets --locked -- -D warnings

# API documentation, in target/doc.
doc:
    RUSTDOCFLAGS=-Dwarnings cargo doc {{ packages }} --no-deps --locked

# Checks the links of README and docs, and builds the book if mdbook is installed.
book:
    python3 ci/book.py

# From a log to a simulated rollout with images; without LOG, the synthetic town.
demo *log:
    ci/demo.sh {{ log }}

# Time per frame on a synthetic street (Criterion).
bench *args:
    cargo bench --locked {{ packages }} --bench frame -- {{ args }}

# The moving picture of README.md (needs Pillow).
picture: build
    PSKEL=target/release/pskel python3 ci/picture.py

# Hashes of what the command writes: two versions that print the same lines render the same maps.
golden shared="../shared": build
    python3 ci/golden.py target/release/pskel {{ shared }}

# Coverage-guided fuzzing of all readers and protocols.
fuzz minutes="10" *targets:
    ci/fuzz.sh {{ minutes }} {{ targets }}

# Licenses, advisories and sources of the dependencies (cargo install cargo-deny).
deny:
    cargo deny --all-features check

# Spelling (cargo install typos-cli).
typos:
    typos
