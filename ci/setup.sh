#!/usr/bin/env bash
# Checks the build and test dependencies other than the Rust toolchain: ci/setup.sh [--yes]
#
# These are C and C++ compilers (for SQLite and the video encoder), a Vulkan loader, a CPU driver (Mesa's lavapipe), the
# validation layer, and Python (for planners in the tests, and for the Python package). Optional is a second driver,
# SwiftShader; without it, tests on a second driver are skipped.
# Lists what is missing and the command that installs it. Installs it with --yes, or if CI is set in the environment.
# Prints nothing if everything is installed; exits with 1 if something required is missing.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "setup: $*" >&2; }

install=${CI:+yes}
case "${1:-}" in
    --yes) install=yes ;;
    "") ;;
    *) say "usage: ci/setup.sh [--yes]"; exit 2 ;;
esac

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

missing() {
    has_compilers || echo g++
    command -v python3 >/dev/null || echo python3
    python3 -c 'import ensurepip, venv' 2>/dev/null || echo python3-venv
    has_loader || echo libvulkan1
    has_driver || echo mesa-vulkan-drivers
    has_layer || echo vulkan-validationlayers
}

check_cargo() {
    local wanted found
    wanted=$(sed -n 's/^rust-version = "\(.*\)"/\1/p' Cargo.toml)
    if ! command -v cargo >/dev/null; then
        say "expected cargo (Rust $wanted or later), found none: see https://rustup.rs"
        exit 1
    fi
    found=$(cargo --version | cut -d' ' -f2)
    if [ "$(printf '%s\n' "$wanted" "$found" | sort -V | head -n1)" != "$wanted" ]; then
        say "expected Rust $wanted or later, found $found: run rustup update"
        exit 1
    fi
}

# Runs apt-get as root.
apt() {
    local root=()
    [ "$(id -u)" -eq 0 ] || root=(sudo)
    "${root[@]}" env DEBIAN_FRONTEND=noninteractive apt-get "$@"
}

install_packages() {
    if ! command -v apt-get >/dev/null; then
        say "expected a C++ compiler, the Vulkan loader, a driver, the validation layer and Python, found no $*"
        say "install them with this system's package manager (Fedora: gcc-c++ vulkan-loader mesa-vulkan-drivers" \
            "vulkan-validation-layers python3; Arch: gcc vulkan-icd-loader vulkan-swrast vulkan-validation-layers python)"
        exit 1
    fi
    if [ "$(id -u)" -ne 0 ] && ! command -v sudo >/dev/null; then
        say "expected root or sudo to install $*, found neither: run apt-get install $* as root"
        exit 1
    fi
    say "installing $*"
    apt update -qq
    apt install -y -qq --no-install-recommends "$@" >/dev/null
}

# Optional: a failed installation is reported, but is no error.
install_swiftshader() {
    local package=chromium-common
    if ! command -v apt-get >/dev/null || { [ "$(id -u)" -ne 0 ] && ! sudo -n true 2>/dev/null; }; then
        say "SwiftShader (part of Chromium) is missing: tests on a second driver will be skipped"
        return
    fi
    say "installing $package (SwiftShader)"
    apt update -qq || true
    if ! apt install -y -qq --no-install-recommends "$package" >/dev/null || ! has_swiftshader; then
        say "no SwiftShader from $package: tests on a second driver will be skipped"
    fi
}

check_cargo
optional=()
has_swiftshader || optional=(chromium-common)
mapfile -t packages < <(missing)
if [ -z "$install" ] && [ "$((${#packages[@]} + ${#optional[@]}))" -gt 0 ]; then
    [ "${#packages[@]}" -eq 0 ] || say "missing: ${packages[*]}"
    [ "${#optional[@]}" -eq 0 ] || say "missing, for tests on a second driver only: ${optional[*]}"
    say "run ci/setup.sh --yes, or: sudo apt-get install --no-install-recommends ${packages[*]} ${optional[*]}"
    [ "${#packages[@]}" -eq 0 ]
    exit
fi
if [ "${#packages[@]}" -gt 0 ]; then
    install_packages "${packages[@]}"
    mapfile -t packages < <(missing)
    if [ "${#packages[@]}" -gt 0 ]; then
        say "expected files of ${packages[*]} after installing them, found none"
        exit 1
    fi
fi
has_swiftshader || install_swiftshader
