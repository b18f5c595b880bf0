#!/usr/bin/env bash
# Everything that is worth knowing of a GPU, in eight minutes at most and with nothing from outside.
#
#   tools/gpu_check.sh pack FOLDER [PYTHON]   here: collect the wheels for that version of Python (as 3.12; default: this one's)
#   tools/gpu_check.sh run FOLDER             there: install them beside what is installed, find the driver, measure
#
# `run` writes logs and JSON documents to $OUT (default: gpu-check). DEVICE picks a device (default: gpu), SMALL=1 takes
# small sizes, for a trial without a GPU. Parts run in order of worth, each within its own limit; one that fails or runs
# out of time stops no other. The exit status is 0 if the kernels compute correctly (doctor) and agree with their twins.
set -uo pipefail
cd "$(dirname "$0")/.."
PACKAGES=(numpy scipy trimesh pyopencl nlopt potpourri3d pillow platformdirs threadpoolctl rich jinja2 pytest hypothesis)

pack() {
  local folder=$1 version=${2:-}
  local options=(--quiet --disable-pip-version-check --only-binary :all: --dest "$folder")
  if [ -n "$version" ]; then
    options+=(--python-version "$version" --implementation cp --platform manylinux_2_28_x86_64 --platform manylinux2014_x86_64)
  fi
  "${PYTHON:-python3}" -m pip download "${options[@]}" "${PACKAGES[@]}" && du -sh "$folder"
}

# The newest Python there is wheels for, preferably one that brings PyTorch.
find_python() {
  local python
  for python in ${PYTHON:-} python3 python python3.13 python3.12 python3.11; do
    command -v "$python" > /dev/null || continue
    "$python" -c 'import sys; sys.exit(sys.version_info < (3, 11))' && echo "$python" && return
  done
  echo "no Python of version 3.11 or later was found" >&2
  return 1
}

# NVIDIA's OpenCL library may lie where no loader looks: then a folder of drivers is made that names it.
find_driver() {
  local folders=(/usr/local/nvidia/lib64 /usr/local/nvidia/lib /usr/lib/x86_64-linux-gnu /usr/lib64 /usr/local/cuda/lib64
    /usr/local/cuda/compat /usr/lib/wsl/lib)
  local library
  if [ -n "${OCL_ICD_VENDORS:-}" ] || ls /etc/OpenCL/vendors/*.icd > /dev/null 2>&1; then
    echo "drivers are named in ${OCL_ICD_VENDORS:-/etc/OpenCL/vendors}"
    return
  fi
  library=$(ldconfig -p 2> /dev/null | sed -n 's/.*libnvidia-opencl.so.1 .*=> //p' | head -n 1)
  [ -n "$library" ] || library=$(find "${folders[@]}" -maxdepth 1 -name 'libnvidia-opencl.so.*' 2> /dev/null | head -n 1)
  if [ -z "$library" ]; then
    echo "no libnvidia-opencl.so.1: neither ldconfig -p nor ${folders[*]} have one, and /etc/OpenCL/vendors names no driver"
    return
  fi
  mkdir -p "$OUT/vendors"
  echo "$library" > "$OUT/vendors/nvidia.icd"
  export OCL_ICD_VENDORS="$PWD/$OUT/vendors"
  case $OUT in /*) OCL_ICD_VENDORS="$OUT/vendors" ;; esac
  export LD_LIBRARY_PATH="$(dirname "$library"):${LD_LIBRARY_PATH:-}"
  echo "driver: $library"
}

# part NAME SECONDS COMMAND...: run within the time that is left; the log is $OUT/NAME.log.
part() {
  local name=$1 limit=$2 status=0 start=$SECONDS
  shift 2
  local left=$((END - SECONDS))
  [ "$left" -gt 5 ] || { echo "$name: no time left" | tee -a "$OUT/summary.txt"; return 1; }
  timeout --kill-after=5 "$((limit < left ? limit : left))" "$@" > "$OUT/$name.log" 2>&1 || status=$?
  local said="status $status"
  [ "$status" -ne 124 ] || said="out of time"
  echo "$name: $said, $((SECONDS - start)) s" | tee -a "$OUT/summary.txt"
  tail -n 12 "$OUT/$name.log"
  return "$status"
}

run() {
  local wheels=$1 python device=${DEVICE:-gpu} quick=() small=() sizes=10000,100000 failed=0
  END=$((SECONDS + ${LIMIT:-470}))
  OUT=${OUT:-gpu-check}
  mkdir -p "$OUT"
  : > "$OUT/summary.txt"
  [ "${SMALL:-0}" = 1 ] && quick=(--quick) && small=(--small) && sizes=2000,4000
  python=$(find_python) || return 1
  { date -u; nvidia-smi; lscpu; "$python" --version; } > "$OUT/machine.txt" 2>&1
  find_driver | tee -a "$OUT/summary.txt"
  # A shell that pipes runs find_driver in a process of its own: what it found is read back.
  if [ -f "$OUT/vendors/nvidia.icd" ]; then
    OCL_ICD_VENDORS=$(cd "$OUT/vendors" && pwd)
    LD_LIBRARY_PATH="$(dirname "$(cat "$OUT/vendors/nvidia.icd")"):${LD_LIBRARY_PATH:-}"
    export OCL_ICD_VENDORS LD_LIBRARY_PATH
  fi
  local packages
  packages=$(mktemp -d)
  if [ -n "$(ls "$wheels"/*.whl 2> /dev/null)" ]; then
    local from=(--quiet --no-index --find-links "$wheels" "${PACKAGES[@]}")
    # An environment that sees what is installed already, such as PyTorch and its numpy, and takes the rest from the wheels.
    if "$python" -m venv --system-site-packages --without-pip "$packages/env" &&
      part install 60 "$python" -m pip --python "$packages/env/bin/python" install "${from[@]}"; then
      python="$packages/env/bin/python"
    else
      part install-beside 60 "$python" -m pip install --target "$packages/beside" "${from[@]}"
    fi
  fi
  export PYTHONPATH="$PWD:$packages/beside" OMP_NUM_THREADS=${OMP_NUM_THREADS:-8} POCL_CACHE_DIR="$packages"
  part doctor 90 "$python" -m clalign.cli.main doctor || failed=1
  part targets 120 "$python" tools/gpu_targets.py --device "$device" --out "$OUT/targets.json" "${small[@]}"
  CLALIGN_DEVICE=$device part tests 100 "$python" -m pytest -q -p no:cacheprovider tests/engine/test_gpu_class.py || failed=1
  part kernels 100 "$python" -m clalign.cli.main bench kernels --parts kernels,losses --device "$device" --repeat 3 \
    --out "$OUT/kernels.json" "${quick[@]}"
  part pair 90 "$python" -m clalign.cli.main bench pair --repeat 1 --set "engine.device=$device" --out "$OUT/pair.json"
  part scale 120 "$python" -m clalign.cli.main bench scale --sizes "$sizes" --set "engine.device=$device" \
    --out "$OUT/scale.json"
  rm -rf "$packages"
  return "$failed"
}

case ${1:-} in
  pack | run) [ $# -ge 2 ] && "$@" ;;
  *) sed -n '2,10s/^# \{0,1\}//p' "$0"; exit 2 ;;
esac
