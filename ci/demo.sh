#!/usr/bin/env bash
# From a recorded drive to condition maps: ci/demo.sh [LOG]
#
# LOG is a drive as pskel names it, for instance nuscenes:/data/nuscenes@v1.0-mini#scene-0061; without it a synthetic
# street is made first. The maps of a few frames come out as PNG with a contact sheet each, once from where the ego
# drove and once from 2 m to the left, turned to the right by 5 degrees.
#
# Environment: OUT (folder of the output, default out/demo), FRAMES (default 0..3), SIZE (of the maps, default
# 256x448), STREET (options of the synthetic street), PROFILE (cargo's, default release).
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)

say() { echo "demo: $*" >&2; }

if [ $# -gt 1 ]; then
    say "expected at most one LOG, found $#"
    exit 2
fi
out=${OUT:-$root/out/demo}
frames=${FRAMES:-0..3}
size=${SIZE:-256x448}
profile=${PROFILE:-release}
read -ra street <<<"${STREET:-}"
log=${1:-}

# Runs a command, tells what it was and how long it took.
timed() {
    local start=$EPOCHREALTIME
    say "$*"
    "$@"
    say "$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f s", b - a }')"
}

# Only what an earlier run made is removed.
clean() {
    if [ -e "$out" ] && [ ! -e "$out/.demo" ] && [ -n "$(ls -A "$out")" ]; then
        say "expected an empty folder or an earlier demo, found other content: $out"
        exit 1
    fi
    mkdir -p "$out"
    touch "$out/.demo"
    rm -rf "$out/log" "$out/skeleton" "$out/maps" "$out/maps-moved"
}

"$root/ci/setup.sh"
export LC_ALL=C # times with a point
manifest=$root/Cargo.toml
timed cargo build --manifest-path "$manifest" --locked --profile "$profile" --bin pskel --example synthetic_street
target=$(cargo metadata --manifest-path "$manifest" --locked --no-deps --format-version 1 | sed -n 's/.*"target_directory":"\([^"]*\)".*/\1/p')
bin=$target/$([ "$profile" = dev ] && echo debug || echo "$profile")
clean
if [ -z "$log" ]; then
    timed "$bin/examples/synthetic_street" --out "$out/log" ${street[@]+"${street[@]}"}
    log=nuscenes:$out/log
fi
timed "$bin/pskel" info "$log"
timed "$bin/pskel" build "$log" --out "$out/skeleton"
render() { timed "$bin/pskel" render "$log" --skeleton "$out/skeleton" --frames "$frames" --out-size "$size" "$@"; }
render --out "$out/maps"
render --out "$out/maps-moved" --ego-offset 0,2,-5

sheets=("$out"/maps/*/sheet.png "$out"/maps-moved/*/sheet.png)
for sheet in "${sheets[@]}"; do
    if [ ! -s "$sheet" ]; then
        say "expected a contact sheet per frame, found none: $sheet"
        exit 1
    fi
done
say "contact sheets in $SECONDS s:"
printf '%s\n' "${sheets[@]}"
