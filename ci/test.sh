#!/usr/bin/env bash
# Checks everything: format, import cycles, lints, documentation, tests, rendering tests again on a second Vulkan driver
# (ci/swiftshader.sh), the Python package (ci/python.sh), the demo on a small town, and its web page in a browser. The
# last line is `N passed, N failed, N skipped`. A test is skipped if its recordings or fixtures are missing (PSKEL_SHARED, PSKEL_FIXTURES) or if the second
# driver lacks a feature; a second driver that is not installed, and a Python environment that cannot be downloaded,
# count as one skipped test each. PSKEL_NO_BROWSER=1 skips the
# browser. Nothing is installed unless CI is set. Spelling and dependencies are checked if typos and cargo-deny are
# installed. PSKEL_ARTIFACTS is a folder for the accuracy table of the demo and screenshots of its page. Exits with 1 on
# any failure.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "test: $*" >&2; }

# All packages; pskel-shaders is compiled for build scripts alone, or all dependencies of it would be compiled twice.
packages=(--workspace --exclude pskel-shaders)
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

# Runs a step and prints its duration.
step() {
    local start=$SECONDS
    say "$*"
    "$@" || { say "failed after $((SECONDS - start)) s: $*"; return 1; }
    say "done in $((SECONDS - start)) s"
}

# Sums the counts of a word (passed, failed, ignored) in the `test result:` lines.
count() {
    sed -nE "s/^test result: .* ([0-9]+) $1;.*/\1/p" "$scratch"/*.log | awk '{ sum += $1 } END { print sum + 0 }'
}

run_tests() {
    export PSKEL_SKIP_LOG="$scratch/skipped" RUST_BACKTRACE=1
    # Skips are counted by test name, and libtest names threads only if there are several.
    RUST_TEST_THREADS=$(nproc | awk '{ print ($1 < 2) ? 2 : $1 }')
    export RUST_TEST_THREADS
    : >"$PSKEL_SKIP_LOG"
    # Unit tests, the suite of each crate, doc tests and a short pass over the fuzz targets; also builds the examples.
    cargo test "${packages[@]}" --locked --no-fail-fast 2>&1 | tee "$scratch/tests.log"
}

# Runs the rendering tests on a second driver.
run_swiftshader() {
    local code=0
    PSKEL_SKIP_LOG="$scratch/skipped-swiftshader" ci/swiftshader.sh 2>&1 | tee "$scratch/swiftshader.log" || code=$?
    # The driver is neither installed nor installable.
    if [ "$code" -eq 77 ]; then
        undrawn=1
        code=0
    fi
    return "$code"
}

# Builds the Python package and runs its tests.
run_python() {
    local code=0
    ci/python.sh 2>&1 | tee "$scratch/python.txt" || code=$?
    # The Python packages of the tests can be neither found nor downloaded.
    if [ "$code" -eq 77 ]; then
        unpythoned=1
        code=0
    fi
    return "$code"
}

# Returns a number of the summary of the Python tests.
python_count() {
    sed -nE "s/^(.*[^0-9])?([0-9]+) $1.* in [0-9.]+s.*$/\\2/p" "$scratch/python.txt" | tail -n 1 | grep . || echo 0
}

# The program built by the tests.
program() {
    cargo metadata --locked --no-deps --format-version 1 | sed -n 's/.*"target_directory":"\([^"]*\)".*/\1\/debug\/pskel/p'
}

run_demo() {
    PSKEL=$(program) OUT="$scratch/demo" TOWN=seed=7,frames=3,size=113x200 FRAMES=0..1 STEPS=4 SIZE=113x200 SIMULATE='' ci/demo.sh
    if [ -n "${PSKEL_ARTIFACTS:-}" ]; then
        mkdir -p "$PSKEL_ARTIFACTS"
        cp "$scratch/demo"/fidelity.{md,csv} "$PSKEL_ARTIFACTS"
    fi
}

# A separate step: ci/page.sh installs Chromium if it is missing, which only CI may do unasked.
run_page() {
    if [ "${PSKEL_NO_BROWSER:-0}" = 1 ]; then
        say "PSKEL_NO_BROWSER: the page is not tested in a browser"
        return
    fi
    if [ -z "${CI:-}" ] && ! command -v chromium && ! command -v chromium-browser && ! command -v google-chrome; then
        say "Chromium is not installed: the page is not tested in a browser"
        return
    fi >/dev/null
    ci/page.sh "$scratch/demo/rollout" ${PSKEL_ARTIFACTS:+"$PSKEL_ARTIFACTS"}
    ci/live.sh "$(program)" town:seed=7,frames=3,size=113x200 "$scratch/demo/skeleton" ${PSKEL_ARTIFACTS:+"$PSKEL_ARTIFACTS"}
}

step ci/setup.sh --tests
# Downloads take minutes, in which the compiler has the processors. A failure shows when the tests install again.
ci/python_env.sh >/dev/null 2>&1 &
step cargo fmt --all --check
step python3 ci/cycles.py
step python3 ci/readme.py
step python3 ci/book.py
if command -v typos >/dev/null; then step typos; fi
if command -v cargo-deny >/dev/null; then step cargo deny --all-features check licenses bans sources; fi # advisories need a network
step cargo clippy "${packages[@]}" --all-targets --locked -- -D warnings
# The smallest builds: the core without formats, and the command without town, network and video.
step cargo clippy -p point-skeleton -p pskel --no-default-features --locked -- -D warnings
RUSTDOCFLAGS=-Dwarnings step cargo doc "${packages[@]}" --no-deps --locked
status=0
undrawn=0
unpythoned=0
: >"$scratch/python.txt"
: >"$scratch/skipped-swiftshader"
step run_tests || status=1
step run_swiftshader || status=1
step run_python || status=1
passed=$(($(count passed) + $(python_count passed)))
failed=$(($(count failed) + $(python_count failed) + $(python_count error)))
ignored=$(($(count ignored) + $(python_count skipped)))
# A failed build or a test that kills its process prints no result line.
if [ "$status" -ne 0 ] && [ "$failed" -eq 0 ]; then
    say "the tests did not run through: counted as one that failed"
    failed=1
fi
if [ "$status" -eq 0 ]; then
    if ! step run_demo || ! step run_page; then
        status=1
    fi
fi

unshared=$(sort -u "$scratch/skipped" | wc -l)
lacking=$(sort -u "$scratch/skipped-swiftshader" | wc -l)
if [ "$unshared" -gt 0 ]; then
    say "$unshared tests skipped for want of the shared data (set PSKEL_SHARED):"
    sort -u "$scratch/skipped" | sed 's/^/test:   /' >&2
fi
[ "$unpythoned" -eq 0 ] || say "no Python environment: the tests of the Python package count as one that is skipped"
[ "$undrawn" -eq 0 ] || say "SwiftShader is not installed: its tests count as one that is skipped"
[ "$lacking" -eq 0 ] || say "$lacking tests skipped on SwiftShader:" "$(sort -u "$scratch/skipped-swiftshader" | tr '\n' ' ')"
say "$((passed + failed + ignored)) tests in $SECONDS s, $unshared of them skipped for want of the shared data"
[ "$status" -eq 0 ] || say "FAILED" $(sed -nE 's/^test (.*) \.\.\. FAILED$/\1/p' "$scratch"/*.log)
skipped=$((unshared + lacking))
echo "$((passed - skipped)) passed, $failed failed, $((ignored + skipped + undrawn + unpythoned)) skipped"
exit "$status"
