# Headless Chromium for tests of pages, sourced by ci/page.sh and ci/live.sh. Installs it with apt if it is missing. Defines
# `run SIZE ARGUMENTS..`, which opens a page in a window of that size with a fresh profile. Needs `say` and `scratch`.
# shellcheck shell=bash

browser() { command -v chromium || command -v chromium-browser || command -v google-chrome; }

install_browser() {
    local root=()
    if ! command -v apt-get >/dev/null; then
        say "expected chromium or apt-get to install it, found neither"
        exit 1
    fi
    [ "$(id -u)" -eq 0 ] || root=(sudo)
    say "installing chromium"
    "${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get update -qq
    "${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends chromium >/dev/null
}

browser >/dev/null || install_browser
chromium=$(browser)

run() {
    local size=$1
    shift
    timeout 300 "$chromium" --headless --no-sandbox --disable-gpu --disable-quic --no-first-run \
        --disable-background-networking --disable-component-update --disable-sync --hide-scrollbars \
        --user-data-dir="$(mktemp -d -p "$scratch")" --window-size="$size" "$@" 2>>"$scratch/browser.log"
}

# The text that a page writes into its element `selftest`.
selftest_text() { sed -nE 's/.*<pre id="selftest"[^>]*>([^<]*).*/\1/p' "$1"; }
