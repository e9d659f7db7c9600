#!/usr/bin/env bash
# From a drive to a page that plays another one: ci/demo.sh [LOG]
#
# LOG is a drive as pskel names it, for instance nuscenes:/data/nuscenes@v1.0-mini#scene-0061; without it the built-in
# town is driven through. Its skeleton is built; condition maps of a few frames come out as PNG with a contact sheet each,
# from where the ego drove, and from 2 m to the left, turned to the right by 5 degrees; of the town, whose truth is known,
# also how true those frames are. Then the drive is simulated with an ego that changes lanes among vehicles that react,
# in the town with images that a network generates, and told by a page and a video. The last lines tell where all of it is.
#
# Environment: OUT (folder of the output, default out/demo), TOWN (the town, default seed=7,frames=40), FRAMES (of the
# maps, default 0..3), STEPS (of the simulation, default 78), SIZE (of all maps, default 256x448), SPLAT (radius by
# depth, default 5:4,15:2,35:1,100:0, which closes holes in what is very near), LOG_ROOTS (options that tell where parts
# of LOG are, as --map-root DIR), SIMULATE (further options of pskel simulate, default --generator network in the town),
# PSKEL (the program; without it a release build is made).
set -euo pipefail
root=$(cd "$(dirname "$0")/.." && pwd)

say() { echo "demo: $*" >&2; }

if [ $# -gt 1 ]; then
    say "expected at most one LOG, found $#"
    exit 2
fi
out=${OUT:-$root/out/demo}
log=${1:-town:${TOWN:-seed=7,frames=40}}
frames=${FRAMES:-0..3}
steps=${STEPS:-78}
size=${SIZE:-256x448}
splat=${SPLAT:-5:4,15:2,35:1,100:0}
read -ra roots <<<"${LOG_ROOTS:-}"
if [[ $log == town:* ]]; then
    generator="--generator network"
fi
read -ra simulate <<<"${SIMULATE-${generator:-}}"

# Runs a command, tells what it was and how long it took.
timed() {
    local start=$EPOCHREALTIME
    say "$*"
    "$@"
    say "$(awk -v a="$start" -v b="$EPOCHREALTIME" 'BEGIN { printf "%.1f s", b - a }')"
}

# Only what an earlier run made is removed; what else is there stops the demo before it compiles.
check_out() {
    if [ -e "$out" ] && [ ! -e "$out/.demo" ] && [ -n "$(ls -A "$out")" ]; then
        say "expected an empty folder or an earlier demo, found other content: $out"
        exit 1
    fi
}

clean() {
    mkdir -p "$out"
    touch "$out/.demo"
    rm -rf "$out/skeleton" "$out/maps" "$out/maps-moved" "$out/rollout" "$out"/fidelity.{md,csv}
}

# Stops unless all of these files are there.
expect_files() {
    local file
    for file in "$@"; do
        if [ ! -s "$file" ]; then
            say "expected a file that is not empty, found none: $file"
            exit 1
        fi
    done
}

check_out
"$root/ci/setup.sh"
export LC_ALL=C # times with a point
pskel=${PSKEL:-}
if [ -z "$pskel" ]; then
    timed cargo build --manifest-path "$root/Cargo.toml" --locked --release --bin pskel
    target=$(cargo metadata --manifest-path "$root/Cargo.toml" --locked --no-deps --format-version 1 | sed -n 's/.*"target_directory":"\([^"]*\)".*/\1/p')
    pskel=$target/release/pskel
fi
clean
built=$SECONDS
pskel() { timed "$pskel" "$1" "$log" ${roots[@]+"${roots[@]}"} "${@:2}"; }
render() { pskel render --skeleton "$out/skeleton" --frames "$frames" --out-size "$size" --splat "$splat" "$@"; }
pskel info
pskel build --out "$out/skeleton"
render --out "$out/maps"
render --out "$out/maps-moved" --ego-offset 0,2,-5
if [[ $log == town:* ]]; then
    pskel fidelity --skeleton "$out/skeleton" --frames "$frames" --out-size "$size" --splat "$splat" \
        --markdown "$out/fidelity.md" --csv "$out/fidelity.csv"
fi
pskel simulate --skeleton "$out/skeleton" --out "$out/rollout" --ego lane_change --actors idm --steps "$steps" \
    --out-size "$size" --splat "$splat" ${simulate[@]+"${simulate[@]}"}

sheets=("$out"/maps/*/sheet.png "$out"/maps-moved/*/sheet.png)
expect_files "${sheets[@]}" "$out"/rollout/{index.html,rollout.mp4,metrics.json}
say "done in $((SECONDS - built)) s after compiling"
say "contact sheets of the maps:"
printf '%s\n' "${sheets[@]}"
say "the rollout as a page and as a video:"
printf '%s\n' "$out/rollout/index.html" "$out/rollout/rollout.mp4"
