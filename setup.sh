#!/bin/sh
# Make or bring up to date the environment .venv: Python >= 3.11, no root, nothing but the package index.
set -eu
cd "$(dirname "$0")"
PYTHON="${PYTHON:-python3}"
"$PYTHON" -c 'import sys; sys.exit("Heliograph needs Python 3.11 or newer, this is " + sys.version) if sys.version_info < (3, 11) else 0'
stamp=.venv/.heliograph-lock
if [ -f "$stamp" ] && cmp -s requirements.lock "$stamp"; then exit 0; fi
[ -x .venv/bin/python ] || "$PYTHON" -m venv .venv
echo "installing the environment (7 GB on disk, half of it CUDA libraries that torch's wheel links against)"
# The lock is complete, hence --no-deps. In pieces and without a cache: the disk never holds every wheel beside the environment.
grep -v '^#' requirements.lock | xargs -n 12 .venv/bin/python -m pip install --quiet --disable-pip-version-check --no-cache-dir --no-deps
.venv/bin/python -m pip install --quiet --disable-pip-version-check --no-deps --editable .
cp requirements.lock "$stamp"
.venv/bin/heliograph doctor
