#!/usr/bin/env bash
# Installs the Python packages of the tests, PyTorch among them (several GB), into target/python, which later runs use again;
# remove the folder to install newer ones. PSKEL_PYTHON_EXTRAS="ray" installs more; the tests that need them are skipped
# without. Waits for another run of itself. Exits with 77 if the packages cannot be downloaded.
set -euo pipefail
cd "$(dirname "$0")/.."

packages=('maturin>=1.16,<2' numpy pytest 'pytest-xdist>=3' mypy 'gymnasium>=1.4' matplotlib tqdm webdataset pillow pandas pyarrow safetensors
    mcap mcap-protobuf-support ${PSKEL_PYTHON_EXTRAS:-})
# Networks and their training; tests are skipped without.
torch=(torch torchvision 'diffusers>=0.35,<1' 'transformers>=4.49,<6' 'accelerate>=1' 'peft>=0.13' sentencepiece protobuf
    tensorboard 'torchmetrics>=1.8' 'torch-fidelity>=0.3' scipy)
# Tests are skipped without each: readers of EXR files, Rerun, a driving policy of another project, and what regenerates the
# messages of AlpaSim.
optional=('opencv-python-headless<5 OpenEXR' rerun-sdk==0.41.0 'grpcio-tools carla-driver-interface==2.3.1')
# Planners of nuPlan run in an environment of their own; their tests are skipped without.
devkit=('numpy<2' shapely geopandas 'SQLAlchemy==1.4.27' pyquaternion scipy opencv-python-headless tqdm retry psutil pytest
    joblib pillow matplotlib rasterio aioboto3 requests)
# So does the development kit of nuScenes.
nuscenes=('nuscenes-devkit==1.2.0')
# So does py123d, which writes logs. It has twice as many dependencies as its writers import: these are installed alone.
py123d=(py123d==0.7.0)
imported=(numpy pyarrow pandas scipy shapely trimesh networkx pyquaternion opencv-python-headless DracoPy laspy cachetools tqdm
    psutil pillow typing-extensions ray)

folder=$(realpath -m "${CARGO_TARGET_DIR:-target}/python")
stamp=$(python3 --version; printf '%s\n' "${packages[@]}" "${torch[@]}" "${optional[@]}" "${devkit[@]}" "${nuscenes[@]}" "${py123d[@]}" "${imported[@]}")
# Modules are compiled when they are imported: most never are.
install() { "$folder/$1/bin/pip" install --quiet --disable-pip-version-check --no-compile "${@:2}"; }

mkdir -p "$(dirname "$folder")"
exec 9>"$folder.lock"
flock 9

if [ "$(cat "$folder/installed" 2>/dev/null)" != "$stamp" ]; then
    rm -rf "$folder"
    python3 -m venv "$folder/env"
    install env "${packages[@]}" || exit 77
    # The build for processors is a tenth as large.
    PIP_RETRIES=0 PIP_TIMEOUT=15 install env torch torchvision --index-url https://download.pytorch.org/whl/cpu 2>/dev/null || true
    complete=1
    install env "${torch[@]}" || complete=
    for group in "${optional[@]}"; do
        # shellcheck disable=SC2086 # several packages
        install env $group || true
    done
    python3 -m venv "$folder/devkit"
    install devkit "${devkit[@]}" || rm -rf "$folder/devkit"
    python3 -m venv "$folder/nuscenes"
    install nuscenes "${nuscenes[@]}" || rm -rf "$folder/nuscenes"
    python3 -m venv "$folder/py123d"
    { install py123d "${imported[@]}" && install py123d --no-deps "${py123d[@]}"; } || rm -rf "$folder/py123d"
    [ -z "$complete" ] || printf '%s\n' "$stamp" >"$folder/installed" # else the next run tries again
fi
