#!/usr/bin/env bash
# Checks the system packages that building and testing need: ci/setup.sh [--yes] [--tests]
#
# Building and rendering need C and C++ compilers (for SQLite and the video encoder), a Vulkan loader and a driver (Mesa's
# lavapipe needs no GPU). Tests also need Vulkan's validation layer and Python (for planners, and for the Python package).
# Optional for tests is a second driver, SwiftShader; without it, tests on a second driver are skipped.
#
# Lists what is missing, and the command that installs it. Installs only with --yes, or if CI is set in the environment.
# Exits with 1 if a package that building needs is still missing; with --tests, also one that tests need. Never installs
# Rust. Prints nothing if everything is installed.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "setup: $*" >&2; }

yes=${CI:-}
tests=
for argument in "$@"; do
    case $argument in
    --yes) yes=1 ;;
    --tests) tests=1 ;;
    *)
        say "expected ci/setup.sh [--yes] [--tests], found $argument"
        exit 2
        ;;
    esac
done
case $yes in 0 | false) yes= ;; esac

# Succeeds if any of the given globs matches a file.
any_file() {
    local file
    for file in "$@"; do
        [ -e "$file" ] && return 0
    done
    return 1
}

has_loader() {
    ldconfig -p 2>/dev/null | grep -q 'libvulkan\.so\.1' || any_file /usr/lib*/libvulkan.so.1 /usr/lib/*/libvulkan.so.1
}

has_driver() {
    any_file "${VK_DRIVER_FILES:-/nonexistent}" "${VK_ICD_FILENAMES:-/nonexistent}" \
        /usr/share/vulkan/icd.d/*.json /etc/vulkan/icd.d/*.json /usr/local/share/vulkan/icd.d/*.json
}

has_layer() {
    local path=VkLayer_khronos_validation.json
    any_file "${VK_LAYER_PATH:-/nonexistent}/$path" {/usr/share,/usr/local/share,/etc}/vulkan/explicit_layer.d/"$path"
}

has_compilers() {
    local cc=${CC:-cc} cxx=${CXX:-c++}
    command -v "${cc%% *}" >/dev/null && command -v "${cxx%% *}" >/dev/null
}

has_swiftshader() {
    any_file /usr/lib*/{chromium,chromium-browser}/vk_swiftshader_icd.json /opt/google/chrome/vk_swiftshader_icd.json
}

# Packages that building and rendering need.
missing() {
    has_compilers || echo g++
    has_loader || echo libvulkan1
    has_driver || echo mesa-vulkan-drivers
}

# Packages that only tests need.
missing_tests() {
    command -v python3 >/dev/null || echo python3
    python3 -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
    has_layer || echo vulkan-validationlayers
}

# Succeeds if cargo is installed, at least in the version of Cargo.toml.
has_cargo() {
    local wanted found
    wanted=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
    if ! command -v cargo >/dev/null; then
        say "missing: Rust $wanted or later, see https://rustup.rs"
        return 1
    fi
    found=$(cargo --version | cut -d' ' -f2)
    if [ "$(printf '%s\n' "$wanted" "$found" | sort -V | head -n1)" != "$wanted" ]; then
        say "missing: Rust $wanted or later (found $found): run rustup update"
        return 1
    fi
}

# Prints the prefix of commands that need root.
as_root() { [ "$(id -u)" -eq 0 ] || echo "sudo "; }

can_install() { command -v apt-get >/dev/null && { [ "$(id -u)" -eq 0 ] || command -v sudo >/dev/null; }; }

install() {
    local root
    root=$(as_root)
    say "installing $*"
    $root env DEBIAN_FRONTEND=noninteractive apt-get update -qq || true # package lists of earlier updates may do
    $root env DEBIAN_FRONTEND=noninteractive apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# Lists packages, and the command that installs them.
advise() {
    if command -v apt-get >/dev/null; then
        say "run ci/setup.sh --yes, or: $(as_root)apt-get install --no-install-recommends $*"
    else
        say "install them with this system's package manager (Fedora: gcc-c++ vulkan-loader mesa-vulkan-drivers" \
            "vulkan-validation-layers python3; Arch: gcc vulkan-icd-loader vulkan-swrast vulkan-validation-layers python)"
    fi
}

status=0
has_cargo || status=1
mapfile -t required < <(missing)
mapfile -t wanted < <(missing_tests)
optional=()
has_swiftshader || optional=(chromium-common)

if [ -n "$yes" ] && can_install; then
    if [ "$((${#required[@]} + ${#wanted[@]}))" -gt 0 ]; then
        install "${required[@]}" "${wanted[@]}" || say "apt-get failed"
        mapfile -t required < <(missing)
        mapfile -t wanted < <(missing_tests)
    fi
    # A failed installation is no error.
    if [ "${#optional[@]}" -gt 0 ]; then
        install "${optional[@]}" || say "apt-get failed"
        if has_swiftshader; then optional=(); fi
    fi
fi

[ "${#required[@]}" -eq 0 ] || say "missing: ${required[*]}"
[ "${#wanted[@]}" -eq 0 ] || say "missing, for tests only: ${wanted[*]}"
[ "${#optional[@]}" -eq 0 ] || say "missing, only for tests on a second driver, which are skipped without: ${optional[*]}"
all=("${required[@]}" "${wanted[@]}" "${optional[@]}")
[ "${#all[@]}" -eq 0 ] || advise "${all[@]}"
if [ "${#required[@]}" -gt 0 ] || { [ -n "$tests" ] && [ "${#wanted[@]}" -gt 0 ]; }; then
    status=1
fi
exit "$status"
