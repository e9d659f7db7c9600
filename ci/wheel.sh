#!/usr/bin/env bash
# Builds the wheel of the Python package into a folder: `ci/wheel.sh [OUT [OPTIONS OF MATURIN]]`, by default out/wheel. PROFILE is
# a Cargo profile (default release). COMPATIBILITY, as in maturin, is linux (default) for machines like this one, or a manylinux
# version such as manylinux_2_28, which maturin verifies.
set -euo pipefail
cd "$(dirname "$0")/.."

out=$(realpath -m "${1:-out/wheel}")
tools=${TOOLS:-out/wheel-tools}
[ -x "$tools/bin/maturin" ] || {
    python3 -m venv "$tools"
    "$tools/bin/pip" install --quiet --disable-pip-version-check 'maturin>=1.16,<2'
}
"$tools/bin/maturin" build --manifest-path python/Cargo.toml --locked --profile "${PROFILE:-release}" \
    --compatibility "${COMPATIBILITY:-linux}" --interpreter python3 --out "$out" "${@:2}" >&2
ls "$out"/pskel-*.whl
