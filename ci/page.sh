#!/usr/bin/env bash
# Tests the web page of a rollout in a browser: ci/page.sh ROLLOUT [PICTURES]
#
# ROLLOUT is an output folder of `pskel simulate`. Headless Chromium opens its index.html with #selftest: the page visits
# all steps and maps, checks that every image loads, and exercises slider, keys, playback and zoom. The test runs in a
# wide and in a narrow window, and once with a missing image, which the page must report. Screenshots are written to
# the folder PICTURES, if given. Chromium is installed with apt if it is missing.
set -euo pipefail

say() { echo "page: $*" >&2; }

if [ $# -lt 1 ] || [ $# -gt 2 ] || [ ! -f "$1/index.html" ]; then
    say "expected the folder of a rollout with index.html, found ${1:-none}"
    exit 2
fi
rollout=$(cd "$1" && pwd)
pictures=${2:-}
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

. "$(dirname "$0")/browser.sh"

# What the page says of itself.
selftest() {
    run "$1" --virtual-time-budget=600000 --dump-dom "file://$2/index.html#selftest" >"$scratch/dom.html" || true
    selftest_text "$scratch/dom.html"
}

for size in 1500,1300 420,900; do
    result=$(selftest "$size" "$rollout")
    case $result in
    PASS*) say "window $size: $result" ;;
    *)
        say "window $size: expected PASS, found ${result:-no result}: $rollout/index.html"
        tail -n 5 "$scratch/browser.log" >&2
        exit 1
        ;;
    esac
done

# A check that cannot fail is none.
cp -r "$rollout" "$scratch/damaged"
find "$scratch/damaged/steps" -name '*.jpg' | sort | tail -n 1 | xargs rm
result=$(selftest 1500,1300 "$scratch/damaged")
case $result in
FAIL:\ pictures*) say "a picture taken away is told: $result" ;;
*)
    say "expected FAIL of a page without a picture, found ${result:-no result}"
    exit 1
    ;;
esac

if [ -n "$pictures" ]; then
    mkdir -p "$pictures"
    run 1500,1300 --virtual-time-budget=5000 --screenshot="$pictures/page.png" "file://$rollout/index.html"
    run 420,1600 --virtual-time-budget=5000 --screenshot="$pictures/narrow.png" "file://$rollout/index.html"
    run 1500,1300 --virtual-time-budget=5000 --blink-settings=preferredColorScheme=0 \
        --screenshot="$pictures/dark.png" "file://$rollout/index.html"
    say "screenshots in $pictures"
fi
