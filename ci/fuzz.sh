#!/usr/bin/env bash
# Coverage-guided fuzzing of all readers and protocols with libFuzzer: ci/fuzz.sh MINUTES [TARGET..]
# The time is divided evenly among the targets (default: all), of which JOBS (default 2) run at a time. The seed
# corpus is crates/fuzz/corpus, which is not changed; new inputs are added to FUZZ_CORPUS (default target/fuzz/corpus),
# which later runs also start from. An input that crashes, hangs for 10 s or exceeds the memory limit is a finding: it is
# minimized and saved, its path is printed, and the exit code is 1. To use it as a test, copy it to
# crates/fuzz/corpus/TARGET. Requires a C++ compiler and stable Rust.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "fuzz: $*" >&2; }

if ! [[ ${1:-} =~ ^[0-9]+$ ]] || [ "$1" -eq 0 ]; then
    say "expected ci/fuzz.sh MINUTES [TARGET..], found ${1:-nothing}"
    exit 2
fi
minutes=$1
shift
jobs=${JOBS:-2}
target_dir=${FUZZ_TARGET_DIR:-$PWD/target/fuzz}
corpus=${FUZZ_CORPUS:-$target_dir/corpus}
findings=$target_dir/findings
triple=$(rustc -vV | sed -n 's/^host: //p')

# Coverage counters of edges and comparisons, with flags of the stable compiler. With --target they do not apply to build scripts.
coverage="-Cpasses=sancov-module -Cllvm-args=-sanitizer-coverage-level=4 -Cllvm-args=-sanitizer-coverage-inline-8bit-counters"
coverage+=" -Cllvm-args=-sanitizer-coverage-pc-table -Cllvm-args=-sanitizer-coverage-trace-compares --cfg fuzzing"
say "building into $target_dir"
RUSTFLAGS="$coverage" CARGO_TARGET_DIR="$target_dir" cargo build --locked --quiet -p point-skeleton-fuzz \
    --features libfuzzer --profile fuzz --target "$triple" --bin fuzz
programs=$target_dir/$triple/fuzz

known=$("$programs/fuzz")
chosen=("$@")
if [ $# -eq 0 ]; then
    mapfile -t chosen < <(cut -d' ' -f1 <<<"$known")
fi
for target in "${chosen[@]}"; do
    if ! grep -q "^$target " <<<"$known"; then
        say "expected targets $(cut -d' ' -f1 <<<"$known" | paste -sd' '), found $target"
        exit 2
    fi
done

# Targets rewrite data sets in every run: use a memory file system if possible.
memory=/dev/shm
[ -w "$memory" ] || memory=${TMPDIR:-/tmp}
scratch=$(TMPDIR=$memory mktemp -d)
trap 'rm -rf "$scratch"' EXIT
mkdir -p "$findings" "$scratch/logs"

seconds=$((minutes * 60 * jobs / ${#chosen[@]}))
[ "$seconds" -ge 5 ] || seconds=5

# Runs libFuzzer on a target with the given options and a separate folder for temporary files.
libfuzzer() {
    local target=$1
    shift
    mkdir -p "$scratch/$target"
    PSKEL_FUZZ_TARGET=$target PSKEL_FUZZ_BYTES=$scratch/logs/$target.bytes TMPDIR=$scratch/$target RAYON_NUM_THREADS=2 \
        "$programs/fuzz" -rss_limit_mb=1024 -timeout=10 "$@"
}

fuzz() {
    local target=$1 max_len
    max_len=$(sed -n "s/^$target //p" <<<"$known")
    mkdir -p "$corpus/$target"
    if ! libfuzzer "$target" -max_len="$max_len" -max_total_time="$seconds" -print_final_stats=1 \
        -artifact_prefix="$findings/$target-" "$corpus/$target" "crates/fuzz/corpus/$target" >"$scratch/logs/$target" 2>&1; then
        local found
        found=$(sed -n 's/.*Test unit written to //p' "$scratch/logs/$target" | tail -1)
        cp "$scratch/logs/$target" "$findings/$target.log"
        # Minimize for at most half a minute.
        if [ -n "$found" ] && timeout 60 bash -c "$(declare -f libfuzzer); $(declare -p scratch programs); \
            libfuzzer $target -minimize_crash=1 -max_total_time=30 -exact_artifact_path='$found.small' '$found'" \
            >/dev/null 2>&1 && [ -s "$found.small" ]; then
            found=$found.small
        fi
        echo "${found:-$findings/$target.log}" >"$scratch/logs/$target.found"
    fi
    rm -rf "${scratch:?}/$target"
}

say "${#chosen[@]} targets, $seconds s each, $jobs at a time"
for target in "${chosen[@]}"; do
    while [ "$(jobs -rp | wc -l)" -ge "$jobs" ]; do wait -n || true; done
    fuzz "$target" &
done
wait

# Prints a number of the final statistics of a log, or of its last progress line if there are no statistics.
stat() { sed -n "s/^stat::$2: *//p" "$scratch/logs/$1" | tail -1; }
last() { sed -nE "s/^#([0-9]+).* $2: ([0-9]+).*/\2/p" "$scratch/logs/$1" | tail -1; }
runs_of() {
    local runs
    runs=$(stat "$1" number_of_executed_units)
    [ -n "$runs" ] || runs=$(sed -nE 's/^#([0-9]+)\t.*/\1/p' "$scratch/logs/$1" | tail -1)
    echo "${runs:-0}"
}

all_runs=0 all_bytes=0 all_edges=0 all_findings=0
printf '%-18s %10s %8s %12s %8s %9s %7s  %s\n' target runs runs/s bytes edges features inputs finding
for target in "${chosen[@]}"; do
    runs=$(runs_of "$target")
    bytes=$(cat "$scratch/logs/$target.bytes" 2>/dev/null || echo 0)
    edges=$(last "$target" cov)
    finding=$(cat "$scratch/logs/$target.found" 2>/dev/null || true)
    printf '%-18s %10d %8d %12d %8d %9d %7d  %s\n' "$target" "$runs" $((runs / seconds)) "$bytes" "${edges:-0}" \
        "$(last "$target" ft || echo 0)" "$(find "$corpus/$target" -type f | wc -l)" "${finding:--}"
    all_runs=$((all_runs + runs)) all_bytes=$((all_bytes + bytes)) all_edges=$((all_edges + ${edges:-0}))
    [ -z "$finding" ] || all_findings=$((all_findings + 1))
done
# Bytes are counted once per second: those of the last second of each target are missing.
echo "$all_runs runs over at least $all_bytes bytes, $all_edges edges in all targets together, $all_findings findings"
[ "$all_findings" -eq 0 ]
