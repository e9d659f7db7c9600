#!/usr/bin/env bash
# Builds the Python package with the dev profile, installs it, and runs its tests under Vulkan's validation layer. Installs
# the packages of the tests first (ci/python_env.sh). Exits with 77 if they cannot be downloaded.
set -euo pipefail
cd "$(dirname "$0")/.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
folder=$(realpath -m "${CARGO_TARGET_DIR:-target}/python")
ci/python_env.sh
TOOLS="$folder/env" PROFILE=dev ci/wheel.sh "$scratch/wheel"
"$folder/env/bin/pip" install --quiet --disable-pip-version-check --no-index --no-deps --force-reinstall "$scratch"/wheel/pskel-*.whl
if [ -d "${PSKEL_SHARED:-../shared}/interop/nuplan-devkit" ] && [ -d "$folder/devkit" ]; then
    export PSKEL_DEVKIT_PYTHON="$folder/devkit/bin/python"
fi
[ ! -d "$folder/nuscenes" ] || export PSKEL_NUSCENES_PYTHON="$folder/nuscenes/bin/python"
[ ! -d "$folder/py123d" ] || export PSKEL_PY123D_PYTHON="$folder/py123d/bin/python"
export PSKEL_VALIDATION=1
# Hundreds of processes import PyTorch: modules are compiled once, here, whatever the caller's environment says.
export PYTHONDONTWRITEBYTECODE= PYTHONPYCACHEPREFIX="$folder/bytecode"
# Two processes, each with the tests of a file after another, the longest first: many tests wait for processes of their own.
export OMP_NUM_THREADS=1
# Not in the folder of the sources, which would hide the installed package.
cd "$scratch"
"$folder/env/bin/python" -m pytest -p no:cacheprovider -q -rs -n 2 --dist loadfile --no-loadscope-reorder --durations=20 "$OLDPWD/python/tests" "$@"
