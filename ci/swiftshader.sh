#!/usr/bin/env bash
# Runs the rendering tests on a second Vulkan driver: ci/swiftshader.sh [TESTS...]
#
# SwiftShader needs no GPU and is part of Chromium (Debian's package chromium-common, installed by ci/setup.sh if
# available). It lacks 64-bit atomics and uses another code generator than Mesa: `graphics` is compared with the CPU
# reference there, tests of `compute` are skipped and counted. TESTS are parts of test names that replace those below.
# Exits with 77 if SwiftShader is not installed.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "swiftshader: $*" >&2; }

# Prints the driver manifest for the Vulkan loader.
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
# Loaders before 1.3.207 know only the second name.
export VK_DRIVER_FILES=$driver VK_ICD_FILENAMES=$driver PSKEL_DEVICE=SwiftShader
if [ $# -eq 0 ]; then
    set -- gpu:: raster:: town_view:: real_frames:: devices_
fi
say "$driver: $*"
cargo test --locked --no-fail-fast --workspace --exclude point-skeleton-fuzz --exclude pskel-shaders --lib --test suite --test devices -- "$@"
