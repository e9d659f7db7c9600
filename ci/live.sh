#!/usr/bin/env bash
# Tests the live page in a browser: ci/live.sh PSKEL LOG SKELETON [PICTURES]
#
# PSKEL is the program, LOG a log and SKELETON its skeleton. Headless Chromium opens the page that `pskel drive` serves, with
# #selftest: keyboard and mouse visit all maps, generate, move the ego, pick, hide, drive, save, and lose the connection. Then
# it does random things with #random. Screenshots are written to the folder PICTURES, if given. SIZE (default 64x112: programs
# without optimization are slow) is the size of the maps in the test, `full` keeps the usual one; MOVES (default 150) is the
# number of random things. Chromium is installed with apt if it is missing.
set -euo pipefail

say() { echo "live: $*" >&2; }

if [ $# -lt 3 ] || [ $# -gt 4 ]; then
    say "expected PSKEL LOG SKELETON [PICTURES], found $# arguments"
    exit 2
fi
program=$1 log=$2 skeleton=$3 pictures=${4:-}
scratch=$(mktemp -d)
server=
stop() {
    [ -z "$server" ] || kill "$server" 2>/dev/null || true
    [ -z "$server" ] || wait "$server" 2>/dev/null || true
    rm -rf "$scratch"
}
trap stop EXIT
. "$(dirname "$0")/browser.sh"

size=${SIZE:-64x112}
generator=(--generator fill --window 2) # the log may be short
if [ "$size" != full ]; then
    printf '{"drawn": "%s", "size": "%s"}' "$size" "$size" >"$scratch/recipe.json"
    generator+=(--recipe "$scratch/recipe.json")
fi
"$program" drive "$log" --skeleton "$skeleton" --out "$scratch/drives" --port 0 --no-browser "${generator[@]}" \
    >"$scratch/url" 2>"$scratch/log" &
server=$!
for _ in $(seq 600); do
    [ -s "$scratch/url" ] && break
    kill -0 "$server" 2>/dev/null || { say "the server ended:"; cat "$scratch/log" >&2; exit 1; }
    sleep 0.1
done
url=$(cat "$scratch/url")

# Opens the page with a hash, and compares what it says of itself.
visit() {
    local size=$1 hash=$2 result
    run "$size" --timeout=280000 --dump-dom "$url#$hash" >"$scratch/dom.html" || true
    result=$(selftest_text "$scratch/dom.html")
    case $result in
    PASS*) say "window $size, $hash: $result" ;;
    *)
        say "window $size, $hash: expected PASS, found ${result:-no result}"
        tail -n 5 "$scratch/log" "$scratch/browser.log" >&2
        exit 1
        ;;
    esac
}

if [ "$size" = full ]; then visit 1280,720 selftest; else visit 1280,720 "selftest&size=$size"; fi
visit 1280,720 "random=${MOVES:-150}&seed=1"
kill -0 "$server" || { say "the server has ended"; exit 1; }

# A screenshot of the page in a state.
picture() {
    local size=$1 state=$2 name=$3 result
    run "$size" --timeout=120000 --screenshot="$pictures/$name.png" --dump-dom "${@:4}" "$url#show=$state" >"$scratch/dom.html" || true
    result=$(selftest_text "$scratch/dom.html")
    [ "$result" = "PASS: shown" ] || { say "picture $name: expected PASS, found ${result:-no result}"; exit 1; }
}

if [ -n "$pictures" ]; then
    mkdir -p "$pictures"
    for state in look picked drive generated; do picture 1280,720 "$state" "live-$state"; done
    picture 1280,720 drive live-dark --blink-settings=preferredColorScheme=0
    picture 420,900 look live-narrow
    picture 1920,1080 drive live-large
    say "screenshots in $pictures"
fi
