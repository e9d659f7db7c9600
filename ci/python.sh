#!/usr/bin/env bash
# Builds the Python package with the dev profile, installs it into a new virtual environment, and runs its tests
# under Vulkan's validation layer.
# PSKEL_PYTHON_EXTRAS="torch ray" also installs PyTorch (several GB) and Ray; the tests that need them are skipped without.
# Exits with 77 if the Python packages of the tests cannot be downloaded.
set -euo pipefail
cd "$(dirname "$0")/.."

scratch=$(mktemp -d)
trap 'rm -rf "$scratch"' EXIT
python3 -m venv "$scratch/env"
pip=("$scratch/env/bin/pip" install --quiet --disable-pip-version-check)
"${pip[@]}" 'maturin>=1.16,<2' numpy pytest mypy 'gymnasium>=1.4' matplotlib tqdm \
    webdataset pillow pandas pyarrow safetensors mcap mcap-protobuf-support || exit 77
"${pip[@]}" rerun-sdk==0.41.0 || true # its tests are skipped without
# Readers of EXR files; their tests are skipped without.
"${pip[@]}" 'opencv-python-headless<5' OpenEXR || true
# A driving policy of another project, and what regenerates the messages of AlpaSim; their tests are skipped without.
"${pip[@]}" grpcio-tools 'carla-driver-interface==2.3.1' || true
TOOLS="$scratch/env" PROFILE=dev ci/wheel.sh "$scratch/wheel"
"${pip[@]}" --no-index "$scratch"/wheel/pskel-*.whl
# Planners of nuPlan run in an environment of their own; their tests are skipped without.
devkit=$(realpath -m "${PSKEL_SHARED:-../shared}/interop/nuplan-devkit")
if [ -d "$devkit" ] && python3 -m venv "$scratch/devkit" && "$scratch/devkit/bin/pip" install --quiet --disable-pip-version-check \
    'numpy<2' shapely geopandas 'SQLAlchemy==1.4.27' pyquaternion scipy opencv-python-headless tqdm retry psutil pytest joblib \
    pillow matplotlib rasterio aioboto3 requests; then
    export PSKEL_DEVKIT_PYTHON="$scratch/devkit/bin/python"
fi
[ -z "${PSKEL_PYTHON_EXTRAS:-}" ] || "${pip[@]}" $PSKEL_PYTHON_EXTRAS
export PSKEL_VALIDATION=1
# Not in the folder of the sources, which would hide the installed package.
cd "$scratch"
"$scratch/env/bin/python" -m pytest -p no:cacheprovider -q -rs "$OLDPWD/python/tests" "$@"
