#!/bin/sh
# Make requirements.lock anew from pyproject.toml: every package, pinned, with the sha256 of each of
# its files. Versions that are in the lock stay, unless pyproject.toml forbids them or they are asked
# to move: `sh .ci/lock.sh --upgrade-package numpy`, or `--upgrade` for all. Needs `uv` on the PATH:
# activate .venv first.
set -eu
cd "$(dirname "$0")/.."
command -v uv >/dev/null || { echo "lock.sh: uv is not on the PATH; activate .venv" >&2; exit 1; }

work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT
cp requirements.lock "$work/lock"

# Names that follow are resolved but not written: the lock's header says why.
set -- "$@" $(printf -- '--no-emit-package %s ' \
    triton cuda-toolkit cuda-bindings cuda-pathfinder nvidia-cuda-cccl nvidia-cusolver nvidia-nvtx pip)
uv pip compile pyproject.toml --extra dev --python-version 3.11 \
    --python-platform x86_64-manylinux_2_35 --generate-hashes --no-annotate --no-header --quiet \
    --output-file "$work/lock" "$@" >/dev/null

{ sed -n '/^#/!q;p' requirements.lock; cat "$work/lock"; } >"$work/new"
mv "$work/new" requirements.lock
echo "requirements.lock: $(grep -c '^[^#[:space:]]' requirements.lock) packages"
