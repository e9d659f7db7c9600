#!/usr/bin/env bash
# Runs the tests that draw on a second Vulkan driver: ci/swiftshader.sh [TESTS...]
#
# SwiftShader needs no GPU and comes with Chromium (Debian's package chromium-common, which ci/setup.sh installs where it can
# be had). It has neither 64-bit atomics nor Mesa's code generator: `raster` is compared with its twin there, tests of
# `compute` are skipped and counted. TESTS are parts of test names, instead of those below. Exits 77 where SwiftShader
# is not there.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "swiftshader: $*" >&2; }

# The file that leads the Vulkan loader to the driver.
manifest() {
    local file
    for file in /usr/lib*/{chromium,chromium-browser}/vk_swiftshader_icd.json /opt/google/chrome/vk_swiftshader_icd.json; do
        [ -e "$file" ] && echo "$file" && return
    done
    return 1
}

if ! driver=$(manifest); then
    say "expected vk_swiftshader_icd.json of Chromium (apt-get install chromium-common), found none: no test is run"
    exit 77
fi
# Loaders before 1.3.207 know the second name alone.
export VK_DRIVER_FILES=$driver VK_ICD_FILENAMES=$driver PSKEL_DEVICE=SwiftShader
if [ $# -eq 0 ]; then
    set -- gpu:: raster:: town_view:: real_frames:: devices_
fi
say "$driver: $*"
cargo test --locked --no-fail-fast --lib --test suite --test devices -- "$@"
